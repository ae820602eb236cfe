"""Motions that are shown side by side."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np


@dataclass(frozen=True, eq=False)
class ReplayedMotion:
    """A motion of a model.

    Attributes:
      title: what moves, such as "after: reality".
      detail: more about it, such as the controller.
      number: its fitness or error with the unit; "" for none.
      model: the model that is drawn.
      qpos: (F, nq) finite generalised positions, at the times of the replay.
    """

    title: str
    detail: str
    number: str
    model: mujoco.MjModel
    qpos: np.ndarray


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
