"""The size of an effect on a tossed body, from its profile: every size with starting states of its own.

A derivative at one size sees the contacts as they are there, and starting states that were found at another one favour
it. The loss of every window is therefore simulated at several sizes; a parabola through its sum smooths what the search
for starting states leaves to chance, and resampled windows give the interval.
"""

from functools import partial

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.scoring.hypotheses import CONTACT_STEP
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged, Side
from btr_mjx.gap.results import Estimate
from btr_mjx.gap.simulate import run_in_threads
from btr_mjx.gap.windows import bounded_loss

_STEPS = np.arange(-4.0, 5.0)
"""Sizes of the profile around the one that was found, in finite-difference steps of what moves contacts."""

_SCALES = 1.0, 2.0, 4.0
"""Factors on these steps that are tried until there is a minimum inside."""

_FEWEST = 6
"""Sizes that a parabola needs."""

_DRAWS = 200
_QUANTILES = (0.05, 0.95)


def profiled(bench: Bench, judged: Judged, rng: np.random.Generator) -> Estimate | None:
    """The estimate of an effect's only number by its profile.

    Args:
      bench: of the search.
      judged: a hypothesis with one effect.
      rng: for the draws.

    Returns:
      The estimate; None where the loss has no minimum among the sizes tried, or the effect has several numbers.
    """
    if len(judged.hypothesis.effects) != 1 or judged.hypothesis.numbers != 1:
        return None
    (candidate, (value,)) = judged.hypothesis.effects[0]
    (parameter,) = candidate.parameters
    head = judged.hypothesis.values(bench.joint)[:-1]
    for scale in _SCALES:
        step = scale * CONTACT_STEP * abs(parameter.step)
        sizes = np.unique(np.clip(value + step * _STEPS, parameter.low, parameter.high))
        worlds = [judged.hypothesis.replaced(np.append(head, size), bench.joint) for size in sizes]
        loss = np.array(run_in_threads([partial(_losses, bench, judged, world) for world in worlds]))  # (sizes, W)
        centre = _lowest(sizes, loss.sum(1)) if len(sizes) >= _FEWEST else None
        if centre is not None:
            break
        value = float(sizes[np.argmin(loss.sum(1))])
    else:
        return None
    scatter = loss.sum(1) - np.polyval(np.polyfit(sizes - centre, loss.sum(1), 2), sizes - centre)
    draws = []
    for _ in range(_DRAWS):
        share = np.bincount(rng.integers(0, loss.shape[1], loss.shape[1]), minlength=loss.shape[1])
        found = _lowest(sizes, loss @ share + rng.choice(scatter, len(sizes)))
        draws.append(sizes[0] if found is None else found)
    low, high = np.quantile(np.array(draws) - centre, _QUANTILES)
    ends = np.clip(centre + np.array([low, high]), parameter.low, parameter.high)
    return Estimate(
        centre, float(ends[0]), float(ends[1]), parameter.unit, float(parameter.null), parameter.at_edge(centre)
    )


def _losses(bench: Bench, judged: Judged, world: Hypothesis) -> np.ndarray:
    """Bounded chi^2 (W,) of the windows of both sides, with starting states and directions that suit a world."""

    def own(side: Side) -> np.ndarray:
        there = side.based(world).with_fitted_states(world).with_own_directions(world)
        return bounded_loss((there.windows.residual**2).sum(1), bench.cut)

    return np.concatenate([own(side) for side in judged.sides])


def _lowest(sizes: np.ndarray, loss: np.ndarray) -> float | None:
    """Where a parabola through losses is lowest; None where that is not between the sizes."""
    middle = float(sizes.mean())
    curve, slope, _ = np.polyfit(sizes - middle, loss, 2)
    at = middle - slope / (2 * curve) if curve > 0 else np.inf
    return float(at) if sizes[0] <= at <= sizes[-1] else None
