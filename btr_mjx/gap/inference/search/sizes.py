"""The size of what moves contacts, tried with starting states of its own at each: derivatives lead nowhere there."""

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.search.line_search import factor_within_bounds, scaled, vertex
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Side
from btr_mjx.gap.windows import Fit

_SIZES = 0.75, 1.3
"""Factors on its size at which what moves contacts is tried beside."""

_MORE = 2, 1
"""Sizes that are tried after these, at most; and where many rivals are tried."""

_NEAR = 0.03
"""Part of a size by which a better one must differ from those that were tried."""


def best_size(
    bench: Bench, hypothesis: Hypothesis, side: Side, reference: Fit, few: bool = False
) -> tuple[Hypothesis, Side]:
    """A hypothesis with its last effect at a better size, where a parabola through three of them peaks, and its side.

    Args:
      bench: of the search.
      hypothesis: its last effect moves contacts.
      side: to fit, that suits it.
      reference: fit of what it is compared with, on the same side.
      few: whether many others are tried as well.
    """
    tried = {1.0: (hypothesis, side)}

    def gain(factor: float) -> float:
        own, there = tried[factor]
        return bench.fall(reference, bench.free(there, own).profile(there.windows.residual, bench.cut))

    def attempt(factor: float) -> None:
        own = scaled(hypothesis, factor)
        tried[factor] = own, side.based(own).with_fitted_states(own, exact=False)

    for factor in _SIZES:
        attempt(factor_within_bounds(hypothesis, factor))
    found = {factor: gain(factor) for factor in tried}
    for _ in range(_MORE[few]):
        best = max(found, key=lambda factor: found[factor])
        # On the way up there is nothing to draw a parabola through yet.
        there = best * _SIZES[0] if best == min(found) else best * _SIZES[1] if best == max(found) else vertex(found)
        there = factor_within_bounds(hypothesis, there)
        if min(abs(there / factor - 1.0) for factor in found) < _NEAR:
            break
        attempt(there)
        found[there] = gain(there)
    return tried[max(found, key=lambda factor: found[factor])]
