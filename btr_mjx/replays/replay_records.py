"""Motions that are shown side by side."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.models import difference, integrate


@dataclass(frozen=True, eq=False)
class ReplayedMotion:
    """A motion of a model.

    Attributes:
      title: what moves, such as "after: reality".
      detail: more about it, such as the controller.
      number: its fitness or error with the unit; "" for none.
      model: the model that is drawn.
      qpos: (F, nq) finite generalised positions, at the times of the replay.
      measured: whether it is what reality did.
    """

    title: str
    detail: str
    number: str
    model: mujoco.MjModel
    qpos: np.ndarray
    measured: bool = False


@dataclass(frozen=True, eq=False)
class Replay:
    """Motions to be shown side by side.

    Attributes:
      times: (F,) of the frames [s].
      rows: motions by row of the film; those of a row are seen by one camera, all of them to one scale.
    """

    times: np.ndarray
    rows: Sequence[Sequence[ReplayedMotion]]

    @property
    def motions(self) -> list[ReplayedMotion]:
        """All motions, row by row."""
        return [motion for row in self.rows for motion in row]


def magnified(replay: Replay, factor: float) -> Replay:
    """A replay in which the simulated motions are further away from the measured one of their row.

    Args:
      replay: the motions.
      factor: by which the difference of positions from the measured motion is multiplied, at every moment; that of
        rotations as a rotation vector. 1 changes nothing.

    Raises:
      InputError: nothing was measured, and the factor is not 1.
    """
    if factor == 1:
        return replay
    if not any(motion.measured for motion in replay.motions):
        raise InputError(f"--magnify {factor:g}: no measured motion is there from which an error could be taken")

    def moved(one: ReplayedMotion, row: Sequence[ReplayedMotion]) -> ReplayedMotion:
        truth = next((other for other in row if other.measured), one)
        if truth is one:
            return one
        error = difference(one.model, truth.qpos, one.qpos)
        qpos = integrate(one.model, truth.qpos, factor * error)
        return replace(one, qpos=qpos, detail=f"error × {factor:g}, {one.detail}")

    return Replay(replay.times, [[moved(one, row) for one in row] for row in replay.rows])


def frame_times(duration: float, frames: int, timestep: float) -> np.ndarray:
    """Ascending times [s] of the frames of a film after its first one, whole time steps; the last is the duration.

    There are fewer frames where there are fewer steps.
    """
    steps = max(1, round(duration / timestep))
    return np.unique(np.round(np.linspace(0, steps, min(frames, steps + 1))[1:])) * timestep


def hold_last_valid(qpos: np.ndarray) -> np.ndarray:
    """Positions (F, nq) in which a state that is not finite is replaced by the last one before it."""
    valid = np.isfinite(qpos).all(axis=1)
    valid[0] = True
    return qpos[np.maximum.accumulate(np.where(valid, np.arange(len(qpos)), 0))]
