"""What held-out recordings can say of an effect that others show: where they hardly see it, that is little."""

import math
from dataclasses import replace

import numpy as np

from btr_mjx.gap.inference.scoring.gains import luckiest, moderate
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.windows import bounded_loss

_PART = 0.5
"""Part of the gain that a name foresees which is enough, of what moves no contacts: a limit that none of the held-out
recordings really reaches foresees little. A true one had 5 beside 1082, another one 6.5 where 17 was foreseen."""

_BEYOND_ALL, _DOWN_TO = 10.0, 1.5
"""Chi^2 per degree of freedom, in units of the dispersion, of a stretch far from anything without an effect, and of one
that is explained. A limit that one of four recordings reached took a stretch from 92 to 1."""

_UNLUCKY = 2.0
"""Standard deviations by which the noise may make it less than that."""


def unmoved(judged: Judged, least: float) -> bool:
    """Whether a candidate changes nothing in the held-out recordings, neither for the better nor for the worse.

    Args:
      judged: the candidate, beside what was found before.
      least: change of a window's chi^2 that is one.
    """
    return bool(np.abs(judged.before[1].chi2 - judged.fits[1].chi2).max() < least)


def vouched(bench: Bench, judged: Judged, needed: float) -> bool:
    """Whether several of the recordings that were fitted vouch for an effect that those held out know little about.

    A limit may be reached in few recordings. Its gain must be worth a name without the recording that gains most, or
    it explains a stretch down to the noise that is beyond anything without it: hundreds of samples by one number.

    Args:
      bench: of the search.
      judged: the candidate, beside what was found before.
      needed: gain that is worth a name.
    """
    before, after = judged.before[0], judged.fits[0]
    fall = bounded_loss(before.chi2, bench.cut) - bounded_loss(after.chi2, bench.cut)
    recording = bench.fit.windows.recording
    each = np.array([fall[recording == r].sum() for r in np.unique(recording)])
    noise = bench.fit.windows.freedom * bench.dispersion
    decided = (before.chi2 > _BEYOND_ALL * noise) & (after.chi2 < _DOWN_TO * noise)
    return bool(each.sum() - each.max() >= needed or (decided.any() and each.sum() >= needed))


def foreseen(bench: Bench, judged: Judged) -> float:
    """Gain on held-out recordings that a candidate foresees: what it changes there, as far as no tolerance absorbs it.

    If it is true, the data lie around its own simulation, and chi^2 falls by the squared distance from there to the
    simulation without it, in the mean over the noise. As in `Bench.fall`, no window says much more than most, and what
    the one that gains most may owe to luck does not count: a limit may be reached in one window that is held out.

    Args:
      bench: of the search.
      judged: the candidate, beside what was found before.
    """
    side, hypothesis = judged.sides[1], judged.hypothesis
    without = replace(hypothesis, effects=hypothesis.effects[:-1])
    change = side.windows.based(without).residual - judged.residual
    fall = bounded_loss(bench.nuisance(side, hypothesis).profile(change, bench.cut).chi2, bench.cut)
    return (float(moderate(fall).sum()) - luckiest(fall)) / bench.dispersion


def likely(hope: float) -> float:
    """Gain on held-out recordings that is enough for a candidate that foresees some there.

    If it is true, chi^2 falls by the squared distance between the simulations with and without it, and by twice the
    inner product of what lies between them and the noise: the gain has the mean d^2 and the variance 4 d^2.

    Args:
      hope: d^2, see `foreseen`.
    """
    return min(_PART * hope, hope - _UNLUCKY * 2.0 * math.sqrt(max(hope, 0.0)))
