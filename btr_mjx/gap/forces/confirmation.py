"""Whether recordings that were not fitted confirm one more effect."""

from btr_mjx.gap.forces.held_out import held_out, is_better
from btr_mjx.gap.forces.points import Fitted, ForceSide
from btr_mjx.gap.forces.predictions import compared_predictions


def is_confirmed(test: ForceSide, before: Fitted, after: Fitted) -> bool:
    """Whether held-out recordings bear out what was fitted with one more effect.

    Predictions over a horizon decide where they can tell. Where noise hides the difference the likelihood decides,
    which sees more, but believes in its variances.

    Args:
      test: the recordings held out.
      before: what was fitted without the effect.
      after: the same with it.
    """
    makes = [fit.point.hypothesis(test.library) for fit in (before, after)]
    told = compared_predictions(test.stretches.data, makes, test.counter)[0, 1]
    return bool(told > 0) if told else is_better(*(held_out(test, fit.point, fit.variances) for fit in (before, after)))
