"""What one more effect brings, reckoned apart from the search."""

from collections.abc import Sequence

from btr_mjx.gap.inference import Bench, Hypothesis
from btr_mjx.gap.inference.search.search_records import Side


def falls(bench: Bench, sides: Sequence[Side], before: Hypothesis, after: Hypothesis) -> list[float]:
    """Falls of the loss from one hypothesis to another on the same windows, of both sides of the split."""
    out = []
    for side, free in zip(sides, (bench.free, bench.nuisance), strict=True):
        fits = [free(side, h).profile(side.windows.residuals([h])[0], bench.cut) for h in (before, after)]
        out.append(bench.fall(*fits, even=True))
    return out
