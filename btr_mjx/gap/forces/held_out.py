"""Held-out recordings: likelihood by stretch, what is left beside the noise, and predictions over a horizon."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.forces.filtering import Variances, filtered, smoothed
from btr_mjx.gap.forces.horizons import SAMPLES, cut_horizons, position_errors, steady_errors
from btr_mjx.gap.forces.motion import linearise_motion
from btr_mjx.gap.forces.points import ForceSide, Point, moved_states
from btr_mjx.gap.forces.search import RELATIVE_ERROR
from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows import PreparedData

HORIZON = 0.25
"""Time over which predictions are compared [s]."""

_UPDATES = 8
"""Updates of variances."""

_HALF = 0.5
"""Part of the believed model's prediction errors that names may leave, where something else is left as well."""

_QUIET = 1e-6
"""Random force that is left where only the noise of sensors is asked for, in units of its standard deviation."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What held-out recordings say of a point.

    Attributes:
      loss: (S,) -2 ln p of each stretch.
      chi2: (S,) of the innovations per measured value, with the noise of the sensors alone.
    """

    loss: np.ndarray
    chi2: np.ndarray

    @property
    def lack(self) -> float:
        """Standard errors by which stretches exceed the noise of the sensors."""
        spread = self.chi2.std(ddof=1) / np.sqrt(len(self.chi2)) if len(self.chi2) > 1 else 1.0
        return float((self.chi2.mean() - 1) / max(spread, 1e-9))


def held_out(side: ForceSide, point: Point, variances: Variances) -> HeldOut:
    """Evaluate a point on recordings that were not fitted, with its numbers and calibration.

    Args:
      side: the recordings held out.
      point: what was fitted.
      variances: as they were estimated on the other side; estimated again here, since other motions excite other
        forces.
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
    quiet = replace(known, force=_QUIET**2 * known.force, weight=None)
    alone = filtered(linear, none, quiet)
    return HeldOut(whitened.gram[:, 0, 0] + whitened.log_determinant + of_weights, alone.gram[:, 0, 0] / alone.count)


def is_better(before: HeldOut, after: HeldOut) -> bool:
    """Whether a hypothesis predicts held-out stretches better by more than two standard errors."""
    fall = before.loss - after.loss
    error = fall.std(ddof=1) / np.sqrt(len(fall)) if len(fall) > 1 else 0.0
    return bool(fall.mean() > 2 * error)


def predicts_better(before: np.ndarray, after: np.ndarray) -> bool | None:
    """Whether predictions over a horizon are better or worse; None where one cannot tell.

    They have to differ by more than two standard errors, and by more than the part by which simulations err. The mean
    is of logarithms of errors: on a few stretches of real recordings everything fails, and so a mean of errors would
    see nothing else.

    Args:
      before: (W, nv) mean square errors of one hypothesis.
      after: the same of another one.
    """
    floor = 1e-12 * before.mean(0) + 1e-300
    fall = np.log((before + floor) / (after + floor)).mean(1)
    error = fall.std(ddof=1) / np.sqrt(len(fall)) if len(fall) > 1 else np.inf
    return bool(fall.mean() > 0) if abs(fall.mean()) > max(2 * error, RELATIVE_ERROR) else None


def horizon_errors(
    data: PreparedData, makes: Sequence[Hypothesis], counter: Counter | None = None, horizon: float = HORIZON
) -> tuple[list[np.ndarray], np.ndarray]:
    """Mean square errors of positions over a horizon from smoothed states.

    Args:
      data: recordings.
      makes: hypotheses.
      counter: adds up the simulated steps.
      horizon: [s].

    Returns:
      For each hypothesis (W, nv), and the same of constant velocity.
    """
    trial = cut_horizons(data, horizon, SAMPLES)
    every = [*position_errors(trial, makes, counter), steady_errors(trial)]
    *found, steady = (np.concatenate([(e**2).mean(1) for e in row]) for row in every)
    return found, steady


def predicts_well(believed: np.ndarray, mended: np.ndarray, steady: np.ndarray) -> bool:
    """Whether predictions (W, nv) of held-out recordings are better than those of two simple predictors.

    Args:
      believed: mean square errors of the believed model.
      mended: those of the mended one.
      steady: those of constant velocity.
    """
    usual = np.maximum(steady.mean(0), 1e-300)
    first, last, simple = (float(np.mean(own / usual)) for own in (believed, mended, steady))
    return last < _HALF**2 * first and last < simple
