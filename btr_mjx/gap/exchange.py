"""What rivals found while their sizes were tried, handed on to all of them before they are compared.

Each hypothesis that moves contacts looks for starting states at every size that it is tried at, and its rivals do not
know what it finds. What a few of these states are worth is more than what tells an offset of the hip from a longer
thigh.
"""

from collections.abc import Sequence
from functools import partial

from btr_mjx.gap.abreast import abreast
from btr_mjx.gap.hypotheses import Hypothesis
from btr_mjx.gap.search_records import Side, nearest


def exchanged(hypotheses: Sequence[Hypothesis], sides: Sequence[Side], moving: Sequence[int]) -> list[Side]:
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
        pool.append(nearest([start, start.recentred(hypotheses[i], exact=False)]))

    def best(i: int) -> Side:
        # Its own comes first: it keeps what others have as well.
        others = (side for side in pool if side is not sides[i])
        return nearest([side.based(hypotheses[i]) for side in (sides[i], *others)])

    return abreast([partial(best, i) for i in range(len(sides))])
