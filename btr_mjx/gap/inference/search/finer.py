"""The size of what moves contacts, and of rivals that come close, with the recordings held out having a say as well.

An offset of a hip, a shorter thigh and an offset of the knee let a foot touch earlier by much the same. Which it is
shows at the size that suits each of them best, and a score has many peaks there: at two thirds of its size a true
length had no more than another number of its leg. That something is missing is not in doubt then, so that all
recordings say how much.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from btr_mjx.gap.inference.scoring.hypotheses import unknowns
from btr_mjx.gap.inference.scoring.refine import refine
from btr_mjx.gap.inference.search.exchange import beside_the_best
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import MARGIN, Judged, Side, among, nearest
from btr_mjx.gap.inference.search.sizes import best_size
from btr_mjx.gap.simulate import run_in_threads
from btr_mjx.gap.windows import Fit

_LEAST = 150.0
"""Score below which no size is looked at: whether anything is missing is the question there."""

_SHARE = 0.02
"""Part of the best score within which rivals are looked at as well, if it is more than what is called equivalent."""

_MOST = 3
"""Candidates that are looked at, at most."""

_ABREAST = 15.0, 0.01
"""Score, and part of the best one, within which rivals are looked at once more: starting states and directions found
around what each had come to put the truth in front in seven of eight limbs, where six had been right."""


def finer(polish: Polisher, judged: Sequence[Judged]) -> list[Judged]:
    """Judge the leader of a first round that moves contacts, and close rivals that do, at other sizes as well.

    Args:
      polish: of the search.
      judged: candidates for a first effect, best first.

    Returns:
      All of them, best first; as they were where the leader moves none or is weak, where much has been spent
      already, or where all sizes are best and no rival is abreast.
    """
    bench, out = polish.bench, list(judged)
    if bench.exhausted():
        return out
    chosen = _chosen(bench, out, MARGIN, _SHARE)
    again = _again(polish, chosen, out) if chosen else []
    if again:
        out = among(out, chosen, beside_the_best(bench, again))
    chosen = [] if bench.costly() else _chosen(bench, out, *_ABREAST)
    return _first(polish, chosen, out) if len(chosen) > 1 else out


def _first(polish: Polisher, chosen: Sequence[Judged], judged: list[Judged]) -> list[Judged]:
    """A round led by whichever of some rivals is ahead when they are judged once more.

    Only that is taken over: from other starting states all of them may have a fifth less, and who was not judged again
    would be in front.
    """
    leader = judged[0]
    scores = {j.name: j.score for j in polish.again([j.hypothesis for j in chosen], None)}
    first = max(chosen, key=lambda j: scores[j.name])
    if first is leader:
        return judged
    ahead = replace(first, score=leader.score + scores[first.name] - scores[leader.name])
    return [ahead, *(j for j in judged if j is not first)]


def _chosen(bench: Bench, judged: Sequence[Judged], margin: float, share: float) -> list[Judged]:
    """The leader and its rivals within a margin, or a part of its score, if it is worth it."""
    if not judged or judged[0].name not in bench.delicate or judged[0].score < _LEAST:
        return []
    margin = max(margin, share * judged[0].score)
    return [j for j in judged if j.name in bench.delicate and judged[0].score - j.score <= margin][:_MOST]


def _again(polish: Polisher, chosen: Sequence[Judged], judged: Sequence[Judged]) -> list[Judged]:
    """Those at their best sizes, from starting states that anybody has found at any of these.

    Args:
      polish: of the search.
      chosen: they.
      judged: they and all others, whose starting states the believed model may use as well.

    Returns:
      Empty where all of them have their best sizes.
    """
    bench, base = polish.bench, polish.bench.base
    pairs = {tuple(map(id, j.sides)): j.sides for j in judged if j.name in bench.delicate}
    known = [[side, *(pair[i] for pair in pairs.values())] for i, side in enumerate(polish.believed())]
    starts = [[nearest([side.based(j.hypothesis) for side in pool]) for pool in known] for j in chosen]
    usual = [nearest([side.based(base) for side in pool]) for pool in known]
    before = _fits(bench, usual)
    ends = run_in_threads(
        [partial(best_size, bench, j.hypothesis, sides, before) for j, sides in zip(chosen, starts, strict=True)]
    )
    hypotheses = [h for h, _ in ends]
    if all(h is j.hypothesis for h, j in zip(hypotheses, chosen, strict=True)):
        return []
    pools = [[*own, *(sides[i] for _, sides in ends)] for i, own in enumerate(known)]
    usual = [nearest([own, *(side.based(base) for side in pool)]) for own, pool in zip(usual, pools, strict=True)]
    references = _fits(bench, usual)
    out = []
    for h, (_, own) in zip(hypotheses, ends, strict=True):
        sides = [nearest([first, *(s.based(h) for s in pool)]) for first, pool in zip(own, pools, strict=True)]
        free, start = unknowns(h, bench.joint, bench.delicate), [h.values(bench.joint)]
        found = refine(sides[0].windows, bench.free(sides[0], h), bench.cut, [(free, start)], 1, references[0])[0]
        h = h.replaced(found.values, bench.joint)
        out += bench.judge([h], [found], (sides[0], sides[1]), references)
    return [replace(one, fresh=j.fresh) for one, j in zip(out, chosen, strict=True)]


def _fits(bench: Bench, sides: Sequence[Side]) -> tuple[Fit, Fit]:
    """Of the believed model on both sides of the split."""
    fit, test = (bench.nuisance(side).profile(side.windows.residual, bench.cut) for side in sides)
    return fit, test
