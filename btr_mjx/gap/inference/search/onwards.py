"""From far away to the best size: leaders are refined on for as long as that leads much nearer to the noise."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis
from btr_mjx.gap.inference.scoring.refine import Refined
from btr_mjx.gap.windows import typical

if TYPE_CHECKING:
    from btr_mjx.gap.inference.search.search import Bench

FAR = 3.0
"""Chi^2 per degree of freedom of the best lead above which limits are tried that the linear picture cannot see: a limit
of a third of what is asked for looked like a motor that is weak by two thirds, which left 3.3."""

_TIMES, _NEARER = 4, 0.7
"""Times that leaders are refined again where none comes near the noise, each of which must leave no more than this part
of chi^2. A delay of 6 ms was 6.7 ms, and 69 was left of 932 where 2 is, after the first time."""


def onwards(
    bench: "Bench",
    hypotheses: Sequence[tuple[Hypothesis, list[np.ndarray]]],
    count: list[int],
    found: list[Refined],
) -> list[Refined]:
    """Leaders of the first round, refined on.

    A few steps from far away do not lead to the best size, and while nothing comes near the noise what is left passes
    for noise, which makes every further step look small. The dispersion of the bench is what is left in the end.

    Args:
      bench: of the search, of a robot that does not touch the world.
      hypotheses: with their starts.
      count: Gauss-Newton steps of each, at most, in one time.
      found: what the first time led to.
    """
    for _ in range(_TIMES):
        before = bench.dispersion
        if before <= FAR:
            break
        starts = [(own, [refined.values]) for (own, _), refined in zip(hypotheses, found, strict=True)]
        further = bench.refined(bench.fit, starts, count, bench.reference[0])
        best = min(further, key=lambda refined: refined.loss).chi2
        if typical(best, bench.fit.windows.freedom) > _NEARER * before * bench.fit.windows.freedom:
            break
        found = further
        bench.settle(best)
    return found
