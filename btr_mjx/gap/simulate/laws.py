"""The state-dependent part of a world: laws that act between two steps on the rows of one world in a batch."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np


@dataclass(frozen=True)
class Rows:
    """Live views of the rows that belong to one world; what a law writes holds for the next step only.

    Before every step the model's fields that laws write, the control and the applied forces are put back to what the
    world says without its laws. A law therefore changes what it finds (`+=`), and laws add up.

    Attributes:
      model: the world's model; its values are those before the laws.
      time: (N,) time at the start of the step [s].
      qpos: (N, nq) configuration at the start of the step.
      qvel: (N, nv) velocity at the start of the step.
      act: (N, na) activation of actuators with a state.
      ctrl: (N, nu) control of the step, sampled in its middle.
      qfrc_applied: (N, nv) generalised force [N or N m].
      xfrc_applied: (N, nbody, 6) force [N] and torque [N m] on bodies, in the world frame.
      actuator_force: (N, nout) force of the actuators in the last step; before the first step, at the start state.
      qfrc_actuator: (N, nv) the same as generalised forces.
      fields: field name -> (N, *field shape).
    """

    model: mujoco.MjModel
    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    ctrl: np.ndarray
    qfrc_applied: np.ndarray
    xfrc_applied: np.ndarray
    actuator_force: np.ndarray
    qfrc_actuator: np.ndarray
    fields: Mapping[str, np.ndarray]

    def field(self, name: str) -> np.ndarray:
        """The rows' own values (N, *field shape) of a field that one of the world's laws declares."""
        return self.fields[name]


class Law(Protocol):
    """What happens to a robot between two steps, as arithmetic on all rows of a world."""

    @property
    def fields(self) -> tuple[str, ...]:
        """The MjModel fields that it writes, as `mujoco.batch.Batch.expand` names them."""

    def __call__(self, rows: Rows) -> None:
        """Act on the coming step of every row."""
