"""Held-out recordings: likelihood by stretch, and what is left beside the noise."""

from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.forces.kalman_filter import Variances, filtered, smoothed
from btr_mjx.gap.forces.motion import linearise_motion
from btr_mjx.gap.forces.points import Fitted, ForceSide, Point, moved_states
from btr_mjx.gap.forces.predictions import compared_predictions

_UPDATES = 8
"""Updates of variances."""

_QUIET = 1e-6
"""Random force that is left where only the noise of sensors is asked for, in units of its standard deviation."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What held-out recordings say of a point.

    Attributes:
      loss: (S,) -2 ln p of each stretch.
      chi2: (S,) of the innovations per measured value, with the noise of the sensors alone.
      sensor: (2 nv,) variances of this noise.
    """

    loss: np.ndarray
    chi2: np.ndarray
    sensor: np.ndarray

    @property
    def lack(self) -> float:
        """Standard errors by which stretches exceed the noise of the sensors."""
        spread = self.chi2.std(ddof=1) / np.sqrt(len(self.chi2)) if len(self.chi2) > 1 else 1.0
        return float((self.chi2.mean() - 1) / max(spread, 1e-9))


def held_out(side: ForceSide, point: Point, variances: Variances, sensor: np.ndarray | None = None) -> HeldOut:
    """Evaluate a point on recordings that were not fitted, with its numbers and calibration.

    Args:
      side: the recordings held out.
      point: what was fitted.
      variances: as they were estimated on the other side; estimated again here, since other motions excite other
        forces.
      sensor: noise (2 nv,) of `HeldOut.chi2`, where it is to be compared with another one; None to estimate it.
    """
    stretches = side.stretches
    make = point.hypothesis(side.library)
    known = replace(variances, weight=None)
    linear = linearise_motion(stretches, make, side.counter)
    nothing = np.zeros_like(linear.defect)
    for i in range(_UPDATES):
        found = smoothed(linear, nothing, known)
        known = found.variances
        if i == _UPDATES // 2:
            linear = linearise_motion(moved_states(stretches, found.state), make, side.counter, linear)
    none = np.zeros((*linear.defect.shape, 0))
    whitened = filtered(linear, none, known)
    assert known.weight is not None
    of_weights = known.share_of_penalty()
    sensor = known.sensor if sensor is None else sensor
    alone = filtered(linear, none, replace(known, sensor=sensor, force=_QUIET**2 * known.force, weight=None))
    loss = whitened.gram[:, 0, 0] + whitened.log_determinant + of_weights
    return HeldOut(loss, alone.gram[:, 0, 0] / alone.count, sensor)


def is_better(before: HeldOut, after: HeldOut) -> bool:
    """Whether a hypothesis predicts held-out stretches better by more than two standard errors.

    A single stretch has no standard error and decides nothing.
    """
    fall = before.loss - after.loss
    return len(fall) > 1 and bool(fall.mean() > 2 * fall.std(ddof=1) / np.sqrt(len(fall)))


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
