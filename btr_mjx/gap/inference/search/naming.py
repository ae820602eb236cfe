"""What may be called by name.

A name needs a score beyond its price on all data, a gain on held-out recordings, and a size beyond what calibration
leaves.
"""

import itertools
from collections.abc import Collection, Sequence

import numpy as np

from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import MARGIN, Judged
from btr_mjx.gap.windows import bounded_loss

THRESHOLD = 15.0
"""Score, beyond the price of its numbers, that a name needs."""

CONTACT_THRESHOLD = 100.0
"""The same of what moves contacts, whose directions are found anew: near a touchdown these are a matter of chance. The
best such candidate of 70 simulated robots that lacked no such thing came to 73 (`benchmarks/gate.py`)."""

HELD_OUT = 3.0
"""Gain that a name needs on held-out recordings, and on those that were fitted."""

SHARE = 0.01
"""Part of the best score within which candidates are alike: of a strong effect calibration leaves more."""

CONTACT_MARGIN = 0.1
"""The same where one of them moves contacts, at least, as a part of the best score."""

TOLERANCES = 3.0
"""Size that a name needs, in tolerances of its parameter."""


def alike(judged: Sequence[Judged], contact_sensitive: Collection[str] = ()) -> list[Judged]:
    """Those that the data cannot tell from the first one, which comes first.

    Args:
      judged: one round, best first.
      contact_sensitive: names of candidates that move contacts, whose scores are less certain.
    """
    best, out = judged[0], []
    for j in judged:
        names = [k.hypothesis.effects[-1][0].name for k in (best, j)]
        margin = max(MARGIN, (CONTACT_MARGIN if any(n in contact_sensitive for n in names) else SHARE) * best.score)
        if best.score - j.score <= margin and j.score > 0.3 * best.score:
            out.append(j)
    return out


def acceptable(bench: Bench, judged: Sequence[Judged], given: Judged | None) -> list[Judged]:
    """One round, with what may be called by name in front of what may not, where the data cannot tell the two apart.

    Where they cannot tell a first effect from something that is no larger than calibration leaves, the latter comes
    first: the feet of a robot that lacks nothing come down a little early or late, too, and its joints rub a little.

    What moves contacts and may not be called by name stands in nobody's way either, its score is a matter of chance up
    to its threshold: beside what was found before, and of a first effect that held-out recordings say more of.

    Args:
      bench: of the search.
      judged: best first.
      given: what was found before.
    """
    close = alike(judged, bench.contact_sensitive) if judged else []
    if not given:
        usual = next((j for j in close if within_calibration(bench, j)), None)
        if usual is not None:
            return [usual, *(j for j in judged if j is not usual)]
    moving = (j.hypothesis.effects[-1][0].name in bench.contact_sensitive for j in judged)
    ahead = next((i for i, moves in enumerate(moving) if not moves), len(judged))
    if given:
        close += list(judged)[: ahead + 1]
    elif 0 < ahead < len(judged) and judged[ahead].held_out > max(j.held_out for j in judged[:ahead]):
        close.append(judged[ahead])
    first = next((j for j in close if accepted(bench, j, given)), None)
    return list(judged) if first is None else [first, *(j for j in judged if j is not first)]


def accepted(bench: Bench, judged: Judged, given: Judged | None) -> bool:
    """Whether a candidate may be called by name.

    Args:
      bench: of the search.
      judged: the candidate, beside what was found before.
      given: what was found before.
    """
    score, gain, held_out = judged.score, judged.gain, judged.held_out
    if given is not None:
        score, gain, held_out = score - given.score, gain - given.gain, held_out - given.held_out
    moves = judged.hypothesis.effects[-1][0].name in bench.contact_sensitive
    needed = CONTACT_THRESHOLD if moves else THRESHOLD
    if given is not None:  # a number of the first effect that is a little off leaves as much
        needed = max(needed, SHARE * given.score)
    enough = score >= needed and min(gain, held_out) >= HELD_OUT
    return enough and not within_calibration(bench, judged) and shrinks_gap(bench, judged, given)


def held_out_chi2(bench: Bench, judged: Judged | None) -> tuple[float, float]:
    """Mean bounded chi^2 of a held-out window per degree of freedom, of the believed model and of a hypothesis."""
    freedom = bench.test.windows.freedom
    base = bench.nuisance(bench.test).profile(bench.test.windows.residual, bench.cut).chi2
    cut = 3.0 * max(freedom, float(np.median(base)))
    ends = base, base if judged is None else judged.fits[1].chi2
    before, after = (float(bounded_loss(chi2, cut).mean() / freedom) for chi2 in ends)
    return before, after


def shrinks_gap(bench: Bench, judged: Judged, given: Judged | None) -> bool:
    """Whether the held-out gap is smaller with a candidate than without it, and than before all that was found."""
    before, after = held_out_chi2(bench, judged)
    return after < before and (given is None or after < held_out_chi2(bench, given)[1])


def within_calibration(bench: Bench, judged: Judged) -> bool:
    """Whether the last effect is no larger than what calibration leaves, or than any simulation of its kind errs.

    Of a number for each member of a group one may be a little larger by chance: what the members explain beyond their
    calibration must be worth a name.
    """
    candidate, values = judged.hypothesis.effects[-1]
    most = [TOLERANCES * bench.tolerances.get(single.name, 0.0) for single in candidate.singles]
    # A slope may be along either axis.
    rows = list(zip(values, candidate.parameters, itertools.cycle(most), strict=False))
    beyond = [
        0.0 if p.shape else max(abs(value - p.null) - max(tolerance, p.negligible), 0.0) for value, p, tolerance in rows
    ]
    if not any(beyond):
        return True
    if len(candidate.singles) == 1:
        return False
    back = [-size if value > p.null else size for size, (value, p, _) in zip(beyond, rows, strict=True)]
    refined = judged.refined
    residual = refined.residual + np.tensordot(back, refined.columns[-len(back) :], 1)
    within = bench.free(judged.sides[0], judged.hypothesis).profile(residual, bench.cut)
    return bool(bench.fall(within, judged.fits[0]) < THRESHOLD)
