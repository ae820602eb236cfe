"""What held-out recordings can say of an effect that others show: where they hardly see it, that is little."""

from dataclasses import replace

import numpy as np

from btr_mjx.gap.gains import luckiest
from btr_mjx.gap.score import bounded
from btr_mjx.gap.search import Bench
from btr_mjx.gap.search_records import Judged


def vouched(bench: Bench, judged: Judged, least: float, needed: float) -> bool:
    """Whether several of the recordings that were fitted vouch for an effect that those held out know nothing about.

    A limit may be reached in few recordings. Where nothing changes in those held out, neither for the better nor for
    the worse, they say nothing against it; then its gain must be worth a name without the recording that gains most.

    Args:
      bench: of the search.
      judged: the candidate, beside what was found before.
      least: change of chi^2 of a held-out window that is one.
      needed: gain that is worth a name.
    """
    before, after = judged.before, judged.fits
    if np.abs(before[1].chi2 - after[1].chi2).max() >= least:
        return False
    fall = bounded(before[0].chi2, bench.cut) - bounded(after[0].chi2, bench.cut)
    recording = bench.fit.windows.recording
    each = np.array([fall[recording == r].sum() for r in np.unique(recording)])
    return bool(each.sum() - each.max() >= needed)


def foreseen(bench: Bench, judged: Judged) -> float:
    """Gain on held-out recordings that a candidate foresees: what it changes there, as far as no tolerance absorbs it.

    If it is true, the data lie around its own simulation, and chi^2 falls by the squared distance from there to the
    simulation without it, in the mean over the noise. As in `Bench.fall`, what the window that gains most may owe to
    luck does not count.

    Args:
      bench: of the search.
      judged: the candidate, beside what was found before.
    """
    side, hypothesis = judged.sides[1], judged.hypothesis
    without = replace(hypothesis, effects=hypothesis.effects[:-1])
    change = side.windows.based(without).residual - judged.residual
    fall = bounded(bench.nuisance(side, hypothesis).profile(change, bench.cut).chi2, bench.cut)
    return (float(fall.sum()) - luckiest(fall)) / bench.dispersion
