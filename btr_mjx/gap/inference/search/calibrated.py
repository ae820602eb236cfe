"""What moves contacts against what calibration leaves, on equal terms.

A leg a millimetre longer and an encoder a milliradian off let a foot touch at another time, and no linear picture says
what that does. Where a length or an offset leads, the limb's own lengths and offsets are therefore refined by true
simulation as well, all together and as far as calibration lets them: what these explain needs no name.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.effects import Candidate, on_same_chain
from btr_mjx.gap.inference.scoring.gains import robust_gain
from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.inference.scoring.refine import Nuisance, Unknowns, refine
from btr_mjx.gap.inference.scoring.screening import tolerance_of
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged, Side, nearest

_OFF = 2.0
"""Where a refinement may start, in tolerances of one number."""

_STARTS = 2
"""The best of these starts are refined."""

_ITERATIONS = 2

_AGAIN = 2
"""Steps of a refinement with other starting states."""

_PROMISING = 15.0
"""Gain in windows that suit the name below which nobody looks further: others can only suit calibration better."""

_CLEAR = 100.0
"""Gain in windows that suit both beyond which nobody looks again."""

_LOOKS = 2, 1
"""Times that starting states are found which suit both: with their first ones a name is ahead by up to 50. And where
much has been spent already."""


@dataclass(frozen=True)
class Beyond:
    """A name against calibration of its limb.

    Attributes:
      gain: robust fall of the loss where the number of the name is free, the prior of calibration included, in units of
        the dispersion, at the look where it is least; infinity where there is nothing to compare with.
      calibrated: the believed model with the limb's numbers as calibration lets them.
    """

    gain: float
    calibrated: Hypothesis


def limb_of(bench: Bench, judged: Judged) -> list[Candidate]:
    """The numbers of a limb that move its contacts and that calibration leaves a little off, with that of a name.

    Args:
      bench: of the search.
      judged: with the name as its last effect.

    Returns:
      Empty where the name moves no contacts, or calibration knows it to be right.
    """
    candidate, _ = judged.hypothesis.effects[-1]
    given, model = bench.dataset.tolerances, bench.dataset.model
    loose = [c for c in bench.candidates if c.name in bench.delicate and tolerance_of(c, given) > 0]
    if all(c is not candidate for c in loose):
        return []
    return [c for c in loose if c is candidate or on_same_chain(model, candidate.place, c.place)]


def beyond_calibration(bench: Bench, judged: Judged) -> Beyond:
    """Gain of a first effect beyond what calibration of its limb explains, on both sides of the split.

    All numbers of the limb are fitted twice, as calibration lets them and with that of the name free. Free it can only
    gain: how much is what the data say for a name, whatever the limb's other numbers are.

    Args:
      bench: of the search.
      judged: the only effect.
    """
    limb = limb_of(bench, judged)
    if len(limb) < 2:
        return Beyond(np.inf, bench.base)
    judged, hypothesis = judged.widest, bench.base
    for candidate in limb:
        hypothesis = hypothesis.with_effect(candidate, candidate.null)
    name, values = judged.hypothesis.effects[-1]
    tied = _unknowns(bench, hypothesis, limb)
    at = len(tied.low) - len(limb) + next(i for i, c in enumerate(limb) if c is name)
    free = replace(tied, precision=np.where(np.arange(len(tied.low)) == at, 0.0, tied.precision))
    end = _refined(bench, judged, hypothesis, tied)
    starts = [tied.centre.copy(), end.copy()]
    for start in starts:
        start[at] = values[0]
    along = bench.free(judged.sides[0], hypothesis)
    both = _Both(
        bench,
        hypothesis,
        judged.sides,
        (tied, free),
        [end, _at_best(judged.sides[0], along, bench.cut, free, [*starts, end], _ITERATIONS)],
    )
    looks, gain, most = 0, both.gain(), _LOOKS[bench.costly()]
    while looks < most and gain >= _PROMISING and not (looks and gain > _CLEAR):
        both.suit(0)
        both.refine()
        both.suit(1)
        looks, gain = looks + 1, min(gain, both.gain())
    calibrated = both.at(0)
    return Beyond(gain, replace(calibrated, effects=(), calibration=calibrated.effects))


class _Both:
    """A limb's numbers as calibration lets them, and with one of them free.

    Attributes:
      ends: values of both.
      sides: of the split, each with the starting states of both.
    """

    def __init__(
        self,
        bench: Bench,
        hypothesis: Hypothesis,
        known: tuple[Side, Side],
        free: tuple[Unknowns, Unknowns],
        ends: list[np.ndarray],
    ) -> None:
        self.bench, self.hypothesis, self.known, self.free, self.ends = bench, hypothesis, known, free, ends
        self.sides = [[side.based(self.at(i)) for i in range(2)] for side in known]

    def at(self, i: int) -> Hypothesis:
        """One of both with its present values."""
        return self.hypothesis.replaced(self.ends[i], self.bench.joint)

    def suit(self, which: int) -> None:
        """Find starting states, and directions, that suit both on one side of the split; each may use the other's."""
        makes = [self.at(i) for i in range(2)]
        own = [
            side.recentred(make, exact=False).redirected(make)
            for side, make in zip(self.sides[which], makes, strict=True)
        ]
        pool = [self.known[which], *own]
        self.sides[which] = [nearest([side.based(make) for side in pool]) for make in makes]

    def refine(self) -> None:
        """Go on from there on the side to fit; what is free may start where the other ended."""
        bench, hypothesis = self.bench, self.hypothesis
        for i, (side, free) in enumerate(zip(self.sides[0], self.free, strict=True)):
            starts = [self.ends[i], *self.ends[:i]]
            self.ends[i] = _at_best(side, bench.free(side, hypothesis), bench.cut, free, starts, _AGAIN)
        self.sides[0] = [side.based(self.at(i)) for i, side in enumerate(self.sides[0])]

    def gain(self) -> float:
        """Fall of the loss where the number is free, the prior included."""
        bench, total = self.bench, 0.0
        for sign, free, end in zip((1.0, -1.0), self.free, self.ends, strict=True):
            total += sign * float((free.precision * (end - free.centre) ** 2).sum())
        for sides, along in zip(self.sides, (bench.free, bench.nuisance), strict=True):
            fits = [along(side, self.at(i)).profile(side.windows.residual, bench.cut) for i, side in enumerate(sides)]
            total += robust_gain(fits[0], fits[1], bench.cut)
        return total / bench.dispersion


def _at_best(
    side: Side, along: Nuisance, cut: float, free: Unknowns, starts: Sequence[np.ndarray], iterations: int
) -> np.ndarray:
    """The best values of the limb's numbers, from the best of some starts."""
    starts = [np.clip(start, free.low, free.high) for start in starts]
    return refine(side.windows, along, cut, [(free, starts)], iterations)[0].values


def _unknowns(bench: Bench, hypothesis: Hypothesis, limb: Sequence[Candidate]) -> Unknowns:
    """All numbers of a limb, with the prior that calibration gives them."""
    free = unknowns(hypothesis, bench.joint, bench.delicate)
    first = len(free.low) - len(limb)
    tolerance = np.array([tolerance_of(c, bench.dataset.tolerances) for c in limb])
    precision, centre = np.zeros(len(free.low)), hypothesis.values(bench.joint)
    precision[first:] = bench.dispersion / tolerance**2
    return replace(free, precision=precision, centre=centre)


def _refined(bench: Bench, judged: Judged, hypothesis: Hypothesis, free: Unknowns) -> np.ndarray:
    """The best values of the limb's numbers, as calibration lets them, in windows that suit a name."""
    side = judged.sides[0]
    along = bench.free(side, hypothesis)
    starts = [free.centre]
    for k in np.flatnonzero(free.precision):
        for sign in (1.0, -1.0):
            off = free.centre.copy()
            off[k] += sign * _OFF * np.sqrt(bench.dispersion / free.precision[k])
            starts.append(np.clip(off, free.low, free.high))
    residuals = side.windows.residuals([free.make(values) for values in starts])
    prior = [float((free.precision * (values - free.centre) ** 2).sum()) for values in starts]
    losses = [along.profile(r, bench.cut).loss + p for r, p in zip(residuals, prior, strict=True)]
    best = np.argsort(losses)[:_STARTS]
    found = refine(side.windows, along, bench.cut, [(free, [starts[i]]) for i in best], _ITERATIONS)
    return min(found, key=lambda one: one.loss).values


def besides(bench: Bench, base: Hypothesis, hypotheses: Sequence[Hypothesis]) -> list[Judged]:
    """Hypotheses refined and judged against another believed model, whose calibration they take over, best first.

    Args:
      bench: of the search.
      base: the believed model with its calibration.
      hypotheses: of the search.
    """
    if not hypotheses:
        return []
    own = copy.copy(bench)
    own.base, own.fit, own.test = base, bench.fit.based(base), bench.test.based(base)
    joined = [replace(base, effects=hypothesis.effects) for hypothesis in hypotheses]
    return sorted(Polisher(own).again(joined, None), key=lambda j: -j.score)
