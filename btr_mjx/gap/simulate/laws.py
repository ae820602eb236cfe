"""Laws: state-dependent changes of forces, controls or model fields, applied before each step of a batch."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np


@dataclass(frozen=True)
class Rows:
    """Views of the batch rows of one world; what a law writes holds for the next step only.

    Before every step the control, the applied forces and the model fields that laws write are reset to the values of
    the world without laws. A law therefore adds to the values (`+=`), and several laws add up.

    Attributes:
      model: the model of the world, without laws.
      time: (N,) time at the start of the step [s].
      qpos: (N, nq) configuration at the start of the step.
      qvel: (N, nv) velocity at the start of the step.
      act: (N, na) activation of actuators with a state.
      ctrl: (N, nu) control of the step, sampled in its middle.
      qfrc_applied: (N, nv) generalised force [N or N m].
      xfrc_applied: (N, nbody, 6) force [N] and torque [N m] on bodies, in the world frame.
      actuator_force: (N, nout) force of the actuators in the last step; before the first step, at the start state.
      qfrc_actuator: (N, nv) generalised force of the actuators, at the same time.
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
        """Values (N, *field shape) of a model field that a law of the world declares in `Law.fields`."""
        return self.fields[name]


class Law(Protocol):
    """A state-dependent change between two steps, computed for all rows of a world at once."""

    @property
    def fields(self) -> tuple[str, ...]:
        """The MjModel fields that the law writes, named as in `mujoco.batch.Batch.expand`."""

    def __call__(self, rows: Rows) -> None:
        """Change the next step of every row."""


@dataclass(frozen=True)
class StateLaw:
    """A law as a function of the rows and of numbers: act(rows, *numbers).

    Attributes:
      act: changes the next step of every row.
      numbers: its other arguments.
      fields: the MjModel fields that it writes.
    """

    act: Callable[..., None]
    numbers: tuple[Any, ...]
    fields: tuple[str, ...] = ()

    def __call__(self, rows: Rows) -> None:
        """See `Law`."""
        self.act(rows, *self.numbers)
