"""Two names whose simulations hardly differ, told apart by that difference alone.

A command that is late by a millisecond and one that is filtered by as much move a leg along paths that differ by less
than the noise. What tells them apart is a sum of small differences over all windows, and starting states that were
found for one and not for the other weigh more than that. Such a rival is therefore tried from the leader's own starting
states, at the size at which it comes nearest to the leader.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.inference.scoring.refine import refine
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import MARGIN, Judged, Side
from btr_mjx.gap.inference.search.walks import scaled
from btr_mjx.gap.windows import bounded_loss

_HARDLY = 20.0
"""Squared distance of two simulations, in units of the noise, up to which they hardly differ: what search for starting
states does to a score is as large."""

_ASIDE = 1.03
"""Factor on a size by which its derivative is found."""

_STEPS = 2
"""Steps towards the size that is most like the leader's: a number that suits the leader by chance must not tell."""


def told_apart(bench: Bench, judged: Sequence[Judged]) -> list[Judged]:
    """A first round with the best of what hardly differs from the leader in front.

    Args:
      bench: of the search.
      judged: best first.

    Returns:
      The same, where the leader moves contacts, has several numbers, or nothing like it comes near its score.
    """
    leader = judged[0]
    rivals = [j for j in judged[1:] if leader.score - j.score <= MARGIN and _single(bench, j)]
    if not rivals or not _single(bench, leader):
        return list(judged)
    tries = [(_ahead(bench, leader.widest, rival.hypothesis), rival) for rival in rivals]
    (ahead, hypothesis), rival = max(tries, key=lambda row: row[0][0])
    if ahead <= 0:
        return list(judged)
    best = replace(_instead(bench, leader, hypothesis), score=leader.score + ahead, fresh=leader.fresh)
    if leader.wide is not None:
        best = replace(best, wide=_instead(bench, leader.wide, hypothesis))
    return [best, leader, *(j for j in judged[1:] if j is not rival)]


def _single(bench: Bench, judged: Judged) -> bool:
    """Whether it is one effect with one number that moves no contacts."""
    candidate, values = judged.hypothesis.effects[-1]
    return len(values) == 1 and candidate.name not in bench.delicate


def _ahead(bench: Bench, leader: Judged, rival: Hypothesis) -> tuple[float, Hypothesis]:
    """By how much a rival explains more than the leader, from its starting states, with the size that is most like it.

    Args:
      bench: of the search.
      leader: with both sides of the split.
      rival: another hypothesis.

    Returns:
      Fall of the bounded chi^2 in units of the dispersion, -inf where the two differ by more than a little; and the
      rival at that size.
    """
    sides, own = leader.sides, leader.hypothesis
    ours = [side.windows.residuals([own])[0] for side in sides]
    for _ in range(_STEPS):
        rival = scaled(rival, _nearer(sides, ours, rival))
    fall = apart = 0.0
    for side, e, along in zip(sides, ours, (bench.free, bench.nuisance), strict=True):
        one, other = along(side, own), along(side, rival)
        theirs = side.windows.residuals([rival])[0]
        apart += float(((one.absorbed(e, bench.cut) - other.absorbed(theirs, bench.cut)) ** 2).sum())
        ends = [bounded_loss(n.profile(r, bench.cut).chi2, bench.cut) for n, r in ((one, e), (other, theirs))]
        fall += float((ends[0] - ends[1]).sum())
    return (fall if apart <= _HARDLY * bench.dispersion else -np.inf) / bench.dispersion, rival


def _nearer(sides: Sequence[Side], ours: Sequence[np.ndarray], rival: Hypothesis) -> float:
    """Factor on the size of a rival that brings it nearer to residuals (W, R) of another hypothesis on some sides.

    Half of the windows, those in which its size changes most, say so each for themselves: in a few of them a foot
    touches at another time.
    """
    parts, weights = [], []
    for side, e in zip(sides, ours, strict=True):
        now, aside = side.windows.residuals([rival, scaled(rival, _ASIDE)])
        size = ((aside - now) ** 2).sum(1)
        parts.append(((aside - now) * (e - now)).sum(1) / np.maximum(size, 1e-300))
        weights.append(size)
    part, size = np.concatenate(parts), np.concatenate(weights)
    there = size >= np.median(size)
    return 1.0 + float(np.median(part[there])) * (_ASIDE - 1.0)


def _instead(bench: Bench, leader: Judged, hypothesis: Hypothesis) -> Judged:
    """A hypothesis judged from the starting states of the leader."""
    side = leader.sides[0]
    free, start = unknowns(hypothesis, bench.joint, bench.delicate), [hypothesis.values(bench.joint)]
    found = refine(side.windows, bench.free(side, hypothesis), bench.cut, [(free, start)], 1, leader.before[0])[0]
    return bench.judge([hypothesis.replaced(found.values, bench.joint)], [found], leader.sides, leader.references)[0]
