"""Line searches over the size of what moves contacts, on some of the windows, with directions of its own at every step.

Directions of the starting states found at one size mislead at another as soon as a foot touches, so that no derivative
leads from one to the other, and the believed model's judge the truth worse than nothing. What the time step does is
not found anew: it changes gains less than the choice of windows.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from threading import Lock

import numpy as np
import scipy

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.inference.search.search_records import Side, nearest
from btr_mjx.gap.windows import Fit

EVERY = 4
"""A line search sees one of so many windows."""

_STRIDE = 1.5
"""Factor on the size at every step of a walk."""

_STRIDES = 3
"""Steps of a walk in either direction, at most."""

_NARROWINGS, _NARROW = 12, 3e-3
"""Evaluations, at most, by which a size is narrowed down where every window is seen, and the factor that is enough."""


class LineSearch:
    """Judges hypotheses on a part of the windows to fit, and remembers what it saw."""

    def __init__(
        self,
        side: Side,
        base: Hypothesis,
        free: Callable[[Side, Hypothesis], Nuisance],
        fall: Callable[[Fit, Fit, float], float],
        cut: Callable[[], float],
        every: int = EVERY,
    ) -> None:
        """Prepare for walks.

        Args:
          side: windows to fit.
          base: the believed model, linearised there.
          free: what is fitted along with a hypothesis on a side.
          fall: of the loss, from one fit to another, given the share of all windows that they see.
          cut: chi^2 above which a window counts less.
          every: one of so many windows is seen.
        """
        self._side, self._base, self._free, self._fall, self._cut = side, base, free, fall, cut
        self._every = every
        self._lock = Lock()
        self._start: tuple[Side, Side] | None = None
        self._nearest: dict[str, Side] = {}
        self._tried: dict[str, dict[tuple[float, ...], tuple[float, Hypothesis]]] = {}

    def gain(self, hypothesis: Hypothesis) -> float:
        """Fall of the loss against the believed model, whose directions are found anew as well; as if of all windows.

        Args:
          hypothesis: with its values.
        """
        known = self._tried.setdefault(hypothesis.name, {})
        values = tuple(hypothesis.values(True))
        if values not in known:
            few, reference = self._started()
            start = few
            if hypothesis.name in self._nearest:
                start = nearest([side.based(hypothesis) for side in (few, self._nearest[hypothesis.name])])
            own = start.with_fitted_states(hypothesis, exact=False).with_own_directions(hypothesis)
            share = len(few.windows) / len(self._side.windows)
            gain = self._fall(self._profile(reference, self._base), self._profile(own, hypothesis), share)
            if gain > self.best(hypothesis.name):
                self._nearest[hypothesis.name] = own
            known[values] = gain, hypothesis
        return known[values][0]

    def _started(self) -> tuple[Side, Side]:
        """Some of the windows, and these as they suit the believed model; hypotheses may be judged in threads."""
        with self._lock:
            if self._start is None:
                few = self._side.some(np.arange(0, len(self._side.windows), self._every))
                self._start = few, few.with_fitted_states(self._base, exact=False).with_own_directions(self._base)
            return self._start

    def best(self, name: str) -> float:
        """Largest gain that was seen of a hypothesis, -inf for one that was never tried.

        Args:
          name: of the hypothesis.
        """
        return max((gain for gain, _ in self._tried.get(name, {}).values()), default=-np.inf)

    def _profile(self, side: Side, hypothesis: Hypothesis) -> Fit:
        return self._free(side, hypothesis).profile(side.windows.residual, self._cut())

    def __call__(self, hypothesis: Hypothesis, hope: float, promise: float) -> Hypothesis | None:
        """Where a walk over the size of the last effect ends.

        Args:
          hypothesis: one that moves contacts.
          hope: gain that it needs before the walk.
          promise: gain that it needs afterwards.

        Returns:
          None for one that has less.
        """
        self.gain(hypothesis)
        hypothesis = max(self._tried[hypothesis.name].values(), key=lambda row: row[0])[1]
        known = {1.0: self.gain(hypothesis)}
        if known[1.0] < hope:
            return None
        for stride in (_STRIDE, 1.0 / _STRIDE):
            factor = 1.0
            for _ in range(_STRIDES):
                there = factor_within_bounds(hypothesis, factor * stride)
                known[there] = self.gain(scaled(hypothesis, there))
                if there == factor or known[there] < known[factor]:
                    break
                factor = there
        if max(known.values()) <= promise:
            return None
        return scaled(hypothesis, vertex(known)) if self._every > 1 else self._narrowed(hypothesis, known)

    def _narrowed(self, hypothesis: Hypothesis, known: Mapping[float, float]) -> Hypothesis:
        """The hypothesis at the size that gains most between the neighbours of the best factor known."""
        at = sorted(known)
        best = max(range(len(at)), key=lambda i: known[at[i]])
        ends = at[max(best - 1, 0)], at[min(best + 1, len(at) - 1)]
        found = scipy.optimize.minimize_scalar(
            lambda factor: -self.gain(scaled(hypothesis, factor)),
            bounds=ends,
            method="bounded",
            options={"maxiter": _NARROWINGS, "xatol": _NARROW},
        )
        return scaled(hypothesis, float(found.x)) if -found.fun > known[at[best]] else scaled(hypothesis, at[best])


def vertex(known: Mapping[float, float]) -> float:
    """Where a parabola through the best of some points and its neighbours peaks; the best where there are no two."""
    at = sorted(known)
    best = max(range(len(at)), key=lambda i: known[at[i]])
    if best in (0, len(at) - 1):
        return at[best]
    near = at[best - 1 : best + 2]
    a, b, _ = np.polyfit(near, [known[factor] for factor in near], 2)
    return float(-b / (2 * a)) if a < 0 else at[best]


def scaled(hypothesis: Hypothesis, factor: float) -> Hypothesis:
    """The same with its last effect farther from its null, or nearer.

    Args:
      hypothesis: with an effect.
      factor: on the distance of its numbers; of those that only say where or how it acts, none.
    """
    candidate, values = hypothesis.effects[-1]
    numbers = tuple(
        value if p.shape else float(np.clip(p.null + factor * (value - p.null), p.low, p.high))
        for p, value in zip(candidate.parameters, values, strict=True)
    )
    return replace(hypothesis, effects=(*hypothesis.effects[:-1], (candidate, numbers)))


def factor_within_bounds(hypothesis: Hypothesis, factor: float) -> float:
    """The factor by which `scaled` moves the last effect away from its null, which bounds may reduce.

    A parabola through sizes beyond a bound, all of them the same world, would peak anywhere.

    Args:
      hypothesis: with an effect.
      factor: on the distance of its numbers.
    """
    candidate, values = hypothesis.effects[-1]
    rows = zip(candidate.parameters, values, scaled(hypothesis, factor).effects[-1][1], strict=True)
    away = np.array(
        [((v - p.null) / (p.high - p.low), (w - p.null) / (p.high - p.low)) for p, v, w in rows if not p.shape]
    )
    size = float(away[:, 0] @ away[:, 0])
    reached = float(away[:, 0] @ away[:, 1]) / size if size > 0 else factor
    return factor if abs(reached - factor) < 1e-9 else reached
