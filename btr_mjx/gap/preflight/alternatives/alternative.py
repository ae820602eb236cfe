"""An alternative: a convention that columns, or the model's gravity, may follow; and the columns that it changes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import joint_of
from btr_mjx.gap.preflight.predictions import Change, ColumnMap
from btr_mjx.models import part_names

HINGE_TYPE, SLIDE_TYPE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True)
class Alternative:
    """A convention that the data may follow.

    Attributes:
      change: what makes data of this convention those of the documented one.
      groups: indices of the groups that it concerns.
      words: what is odd, for messages.
      remedy: what to do.
      topic: kind of convention.
      nuisance: physics instead of a convention: never reported, but a convention must do better.
      elsewhere: only other coordinates may show it: a servo whose positions and commands are wrong alike follows well.
    """

    change: Change
    groups: tuple[int, ...]
    words: str
    remedy: str
    topic: str
    nuisance: bool = False
    elsewhere: bool = False


@dataclass(frozen=True, eq=False)
class LoggedColumns:
    """Columns of positions and commands of a dataset.

    Attributes:
      model: the believed model.
      joints, actuators: names.
      drives: actuators of each driven joint.
      low, high: (nq,) smallest and largest positions.
      command_reach: (nu,) largest commands, without sign.
    """

    model: mujoco.MjModel
    joints: Sequence[str]
    actuators: Sequence[str]
    drives: Mapping[int, Sequence[int]]
    low: np.ndarray
    high: np.ndarray
    command_reach: np.ndarray

    @staticmethod
    def of(dataset: Dataset) -> "LoggedColumns":
        """Those of a dataset."""
        model, drives = dataset.model, dict[int, list[int]]()
        for a in range(model.nu):
            if (joint := joint_of(model, a)) is not None:
                drives.setdefault(joint, []).append(a)
        qpos, ctrl = (
            np.concatenate([x[:: max(1, len(x) // 2000)] for x in columns])
            for columns in ([r.qpos for r in dataset.recordings], [r.ctrl for r in dataset.recordings])
        )
        return LoggedColumns(
            model,
            part_names(model, "joint"),
            part_names(model, "actuator"),
            drives,
            qpos.min(axis=0),
            qpos.max(axis=0),
            np.abs(ctrl).max(axis=0),
        )

    def reach(self, joint: int) -> float:
        """Largest position of a hinge or slide, without sign."""
        q = int(self.model.jnt_qposadr[joint])
        return float(max(-self.low[q], self.high[q]))

    def is_servo(self, actuator: int) -> bool:
        """Whether an actuator is a position servo."""
        return float(self.model.actuator_biasprm[actuator, 1]) < 0

    def servos(self, joints: Sequence[int]) -> list[int]:
        """The position servos of joints."""
        return [a for joint in joints for a in self.drives.get(joint, []) if self.is_servo(a)]

    def motors(self, joints: Sequence[int]) -> list[int]:
        """The other actuators of joints."""
        return [a for joint in joints for a in self.drives.get(joint, []) if not self.is_servo(a)]

    def qpos(self, columns: Sequence[int] | np.ndarray = (), scale: float = 1.0, offset: float = 0.0) -> ColumnMap:
        """A change of some columns of positions."""
        return ColumnMap.affine(self.model.nq, columns, scale, offset)

    def ctrl(self, actuators: Sequence[int] = (), scale: float = 1.0, offset: float = 0.0) -> ColumnMap:
        """A change of some commands."""
        return ColumnMap.affine(self.model.nu, actuators, scale, offset)

    def joints_times(self, joints: Sequence[int], scale: float, offset: float = 0.0) -> ColumnMap:
        """A change of the positions of hinges and slides."""
        return self.qpos(self.model.jnt_qposadr[list(joints)], scale, offset)

    def changed(self, qpos: ColumnMap | None = None, ctrl: ColumnMap | None = None) -> Change:
        """A change of positions, commands or both."""
        return Change(qpos or self.qpos(), ctrl or self.ctrl())
