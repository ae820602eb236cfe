"""What rivals found while their sizes were tried, handed on to all of them before they are compared window by window.

Each hypothesis that moves contacts looks for starting states at every size that it is tried at, and its rivals do not
know what it finds. What a few of these states are worth is more than what tells an offset of the hip from a longer
thigh.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.scoring.gains import robust_gain, trimmed_gain
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged, Side, nearest
from btr_mjx.gap.simulate import run_in_threads


def share_starting_states(hypotheses: Sequence[Hypothesis], sides: Sequence[Side], moving: Sequence[int]) -> list[Side]:
    """Every window of every hypothesis from where it comes nearest to the data, of all that any of them found.

    Args:
      hypotheses: those that are compared, at their best size.
      sides: that suit them.
      moving: which of them move contacts and have starting states of their own.

    Returns:
      Their sides, those they have where fewer than two have any of their own.
    """
    if len(moving) < 2:
        return list(sides)
    pool = list(sides)
    for i in moving:
        start = nearest([side.based(hypotheses[i]) for side in pool])
        pool.append(nearest([start, start.with_fitted_states(hypotheses[i], exact=False)]))

    def best(i: int) -> Side:
        # Its own comes first: it keeps what others have as well.
        others = (side for side in pool if side is not sides[i])
        return nearest([side.based(hypotheses[i]) for side in (sides[i], *others)])

    return run_in_threads([partial(best, i) for i in range(len(sides))])


def compare_with_best(bench: Bench, judged: Sequence[Judged]) -> list[Judged]:
    """The same with scores that differ by how the best of them and each other one differ window by window.

    Most of what rivals gain they gain together; what tells them apart is lost in how much of that may be luck.
    Between two that move contacts, what a few windows say is luck as well.

    Args:
      bench: of the search.
      judged: with starting states that they share.
    """
    best = max(judged, key=lambda j: j.score)
    price = (best.gain + best.held_out - best.score) / best.hypothesis.numbers
    moving = {j.name for j in judged if j.hypothesis.effects[-1][0].name in bench.contact_sensitive}
    out = []
    for j in judged:
        compared = trimmed_gain if {best.name, j.name} <= moving else robust_gain
        gain, held_out = (
            now + compared(a, b, bench.cut) / bench.dispersion
            for now, a, b in zip((best.gain, best.held_out), best.fits, j.fits, strict=True)
        )
        score = gain + held_out - price * j.hypothesis.numbers
        out.append(j if j is best else replace(j, gain=gain, held_out=held_out, score=score))
    return out
