"""What moves contacts against what calibration leaves, on equal terms.

A leg a millimetre longer and an encoder a milliradian off let a foot touch at another time, and no linear picture says
what that does. Where a length or an offset leads, the limb's own lengths and offsets are therefore refined by true
simulation as well, all together and as far as calibration lets them: what these explain needs no name.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from btr_mjx.gap.effect import Candidate
from btr_mjx.gap.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.places import one_limb
from btr_mjx.gap.refine import Refined, Unknowns, refine
from btr_mjx.gap.score import robust_gain
from btr_mjx.gap.screening import tolerance_of
from btr_mjx.gap.search import Bench
from btr_mjx.gap.search_records import Judged, Side, nearest

_OFF = 2.0
"""Where a refinement may start, in tolerances of one number."""

_STARTS = 2
"""The best of these starts are refined."""

_ITERATIONS = 3


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
    return [c for c in loose if c is candidate or one_limb(model, candidate.place, c.place)]


def beyond_calibration(bench: Bench, judged: Judged) -> float:
    """Gain of a first effect over the best that calibration of its limb explains, on both sides of the split.

    Args:
      bench: of the search.
      judged: the only effect.

    Returns:
      Robust fall of the loss, the prior of calibration included, in units of the dispersion; infinity where there is
      nothing to compare with.
    """
    limb = limb_of(bench, judged)
    if len(limb) < 2:
        return np.inf
    judged, hypothesis = judged.widest, bench.base
    for candidate in limb:
        hypothesis = hypothesis.with_effect(candidate, candidate.null)
    free = _unknowns(bench, hypothesis, limb)
    found = _refined(bench, judged, hypothesis, free)
    rival = hypothesis.replaced(found.values, bench.joint)
    side = _suited(judged.sides[0], rival)
    again = refine(side.windows, bench.free(side, rival), bench.cut, [(free, [found.values])], _ITERATIONS)[0]
    rival = hypothesis.replaced(again.values, bench.joint)
    gain = float((free.precision * (again.values - free.centre) ** 2).sum())
    for own, along, fit in zip((side, judged.sides[1]), (bench.free, bench.nuisance), judged.fits, strict=True):
        own = _suited(own, rival)
        gain += robust_gain(along(own, rival).profile(own.windows.residual, bench.cut), fit, bench.cut)
    return gain / bench.dispersion


def _suited(side: Side, rival: Hypothesis) -> Side:
    """A side with starting states that suit another hypothesis, where they do."""
    side = side.based(rival)
    return nearest([side, side.recentred(rival, exact=False).redirected(rival)])


def _unknowns(bench: Bench, hypothesis: Hypothesis, limb: Sequence[Candidate]) -> Unknowns:
    """All numbers of a limb, with the prior that calibration gives them."""
    free = unknowns(hypothesis, bench.joint, bench.delicate)
    first = len(free.low) - len(limb)
    tolerance = np.array([tolerance_of(c, bench.dataset.tolerances) for c in limb])
    precision, centre = np.zeros(len(free.low)), hypothesis.values(bench.joint)
    precision[first:] = bench.dispersion / tolerance**2
    return replace(free, precision=precision, centre=centre)


def _refined(bench: Bench, judged: Judged, hypothesis: Hypothesis, free: Unknowns) -> Refined:
    """The best values of the limb's numbers in windows that suit a name."""
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
    return min(found, key=lambda one: one.loss)
