"""What of a prediction's errors a delay of the commands, or the time step of the model, accounts for.

Errors of short predictions are regressed on what a delay, a finer time step, and errors of calibration do to them.
Calibration is known to some per cent only and delays a response as well, so that a delay is told beside it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Recording
from btr_mjx.gap.preflight.predictions import Change, Predictor, Reading

DIVISOR = 4
"""Divisor of the time step that a finer one is tried with."""

_CALIBRATION = 0.1
"""Standard deviation of what is believed of gains, damping, inertia and friction, as a share."""

_SHIFT = 0.1
"""Shift of commands whose effect is taken for that of a delay, as a share of a stretch; a sampling interval at most."""


@dataclass(frozen=True)
class TimingEstimate:
    """Estimates from the errors of predictions, each with its standard error.

    Attributes:
      delay: of the response behind the believed model's [s].
      step: share of the change by a finer step that the errors ask for: 0 where the model's own step predicts right, 1
        where the finer one does, 4 / 3 where an infinitely small one does.
      stretches: that were looked at.
    """

    delay: tuple[float, float]
    step: tuple[float, float]
    stretches: int


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Errors of short predictions, and how they change.

    Attributes:
      seconds: length of a stretch.
      recording: (W,) index of the recording of each stretch.
      error: (W, samples, nv) measured minus predicted positions.
      columns: of the same shape each: changes by a delay of one second, a finer step, and errors of calibration.
      noise: (nv,) of positions.
    """

    seconds: float
    recording: np.ndarray
    error: np.ndarray
    columns: tuple[np.ndarray, ...]
    noise: np.ndarray

    @classmethod
    def of(
        cls, predictor: Predictor, recordings: Sequence[Recording], noise: np.ndarray, at: float | np.ndarray = 0.0
    ) -> "PredictionErrors":
        """Simulate all stretches of a predictor with each change.

        Args:
          predictor: with some stretches.
          recordings: that it predicts.
          noise: (nv,) of positions.
          at: shift of the commands [s], a number or one for each recording.
        """
        none = [Change.none(recordings[0].model)]
        shift = min(command_interval(recordings), _SHIFT * predictor.seconds)
        seen = np.all([one.seen for one in recordings], axis=0)
        measured, now = predictor.motions(none, Reading(at))[0]

        def moved(reading: Reading) -> np.ndarray:
            return np.where(seen, predictor.motions(none, reading)[0][1] - now, 0.0)

        late, early = (moved(Reading(at + s)) for s in (shift, -shift))
        more = [moved(Reading(at, step_divisor=DIVISOR)), *(moved(Reading(at, edit=edit)) for edit in _calibrations())]
        columns = ((late - early) / (2 * shift), *more)
        left = np.where(seen, measured - now, 0.0)
        return cls(predictor.seconds, predictor.start_times()[0], left, columns, noise)

    def estimate(self, recordings: Sequence[int] | None = None) -> TimingEstimate:
        """What is left, in stretches of some recordings, or in all."""
        own = np.ones(len(self.recording), bool) if recordings is None else np.isin(self.recording, recordings)
        spread = [np.inf, *[1.0] * (len(self.columns) - 1)]
        values, errors = regressed(self.error[own], [column[own] for column in self.columns], self.noise, spread)
        return TimingEstimate((values[0], errors[0]), (values[1], errors[1]), int(own.sum()))

    @property
    def seen_by_step(self) -> float:
        """Root mean square change of positions by the finer step, in units of the noise."""
        with np.errstate(invalid="ignore", over="ignore"):
            change = np.nanmean(self.columns[1] ** 2, axis=(0, 1))
        moved = change > 0
        return (
            float(np.sqrt(np.mean(change[moved] / np.maximum(self.noise[moved], 1e-12) ** 2))) if moved.any() else 0.0
        )

    @property
    def gain_of_step(self) -> float:
        """Ratio of the variances of errors with the model's own step and with the finer one."""
        known = np.maximum(self.noise, 1e-12)
        own, finer = (float(np.nansum((error / known) ** 2)) for error in self.errors())
        return own / max(finer, 1e-300)

    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """(nv,) root mean square errors of positions with the model's own step and with the finer one [rad or m]."""
        with np.errstate(invalid="ignore", over="ignore"):
            own, finer = (np.sqrt(np.nanmean(x**2, axis=(0, 1))) for x in (self.error, self.error - self.columns[1]))
        return own, finer


def command_interval(recordings: Sequence[Recording]) -> float:
    """Usual time between two commands [s]."""
    return float(np.median([np.median(np.diff(one.commands[0])) for one in recordings]))


def regressed(
    left: np.ndarray, columns: Sequence[np.ndarray], noise: np.ndarray, spread: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Least squares with coordinates weighted by what is left of them, and stretches as independent samples.

    Args:
      left: (W, samples, nv) errors; values that are not finite do not count.
      columns: (W, samples, nv) each, what a number does to them.
      noise: (nv,) of positions.
      spread: standard deviation of what is known of each number beforehand; inf for nothing.

    Returns:
      Values and standard errors of the numbers.
    """
    if not len(left):
        return [0.0] * len(columns), [np.inf] * len(columns)
    with np.errstate(all="ignore"):
        size = np.sqrt(np.nanmedian(left**2, axis=(0, 1))) + noise + 1e-12
        rows = [np.nan_to_num(x / size, nan=0.0, posinf=0.0, neginf=0.0) for x in (left, *columns)]
    good = np.all([np.abs(row) < 1e6 for row in rows], axis=0)
    target, *others = (np.where(good, row, 0.0).reshape(len(left), -1) for row in rows)
    matrix = np.stack(others, axis=-1)  # (W, N, p)
    # A column that nothing changes, as the friction of a model without, has no value.
    scale = np.sqrt(np.einsum("wnp,wnp->p", matrix, matrix))
    used = np.flatnonzero(scale > 0)
    matrix, known = matrix[..., used] / scale[used], 1 / (scale[used] * np.array(spread)[used]) ** 2
    power, pull = np.einsum("wnp,wnq->pq", matrix, matrix), np.einsum("wnp,wn->p", matrix, target)
    per_stretch, variance = target.shape[1], 0.0
    for _ in range(3):  # the prior counts in units of what is left, whose samples of a stretch err together
        inverse = np.linalg.pinv(power + np.diag(variance * known), rcond=1e-12, hermitian=True)
        found = inverse @ pull
        rest = target - matrix @ found
        variance = float(np.mean(rest**2)) * per_stretch / max(noise.size, 1)
    scores = np.einsum("wnp,wn->wp", matrix, rest)
    covariance = inverse @ (scores.T @ scores + np.diag(variance**2 * known)) @ inverse
    values, errors = np.zeros(len(columns)), np.full(len(columns), np.inf)
    values[used], errors[used] = found / scale[used], np.sqrt(np.diag(covariance)) / scale[used]
    return values.tolist(), errors.tolist()


def _calibrations() -> list[Callable[[mujoco.MjModel], None]]:
    """Edits by one standard deviation of calibration: stiffness of servos, damping, rotor inertia, masses, friction."""
    factor = 1 + _CALIBRATION

    def stiffness(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[:, 0] *= factor
        model.actuator_biasprm[:, 1] *= factor

    def damping(model: mujoco.MjModel) -> None:
        model.actuator_biasprm[:, 2] *= factor
        model.dof_damping[:] *= factor

    def rotors(model: mujoco.MjModel) -> None:
        model.dof_armature[:] *= factor
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def masses(model: mujoco.MjModel) -> None:
        model.body_mass[:] *= factor
        model.body_inertia[:] *= factor
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def friction(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[:] *= factor

    return [stiffness, damping, rotors, masses, friction]
