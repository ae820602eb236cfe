"""Which effects of a search recordings confirm that were not fitted."""

from collections.abc import Sequence

from btr_mjx.gap.forces.held_out import held_out, is_better
from btr_mjx.gap.forces.points import Fitted, ForceSide
from btr_mjx.gap.forces.predictions import compared_predictions


def confirmed_chain(test: ForceSide, chain: Sequence[Fitted]) -> list[Fitted]:
    """The chain up to the last hypothesis that held-out recordings bear out, one after another.

    Predictions over a horizon decide where they can tell. Where noise hides the difference the likelihood decides,
    which sees more, but believes in its variances.
    """
    makes = [fit.point.hypothesis(test.library) for fit in chain]
    better = compared_predictions(test.stretches.data, makes, test.counter)
    out, before = [chain[0]], held_out(test, chain[0].point, chain[0].variances)
    for i, fit in enumerate(chain[1:]):
        own = held_out(test, fit.point, fit.variances)
        told = better[i, i + 1]
        if not (told > 0 if told else is_better(before, own)):
            break
        before = own
        out.append(fit)
    return out
