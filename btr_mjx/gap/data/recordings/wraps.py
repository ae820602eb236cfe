"""Angles that jump by a turn: encoders that report a continuous joint in [-pi, pi) or [0, 2 pi)."""

from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.models import part_names

_OUTLIER = 3.0
"""A jump by a turn exceeds all other steps by this factor at least; otherwise the steps are just large (degrees)."""


@dataclass(frozen=True)
class Wrap:
    """Jumps of a hinge by a turn.

    Attributes:
      joint: id of the joint.
      rows: rows after the jumps.
      turn: 2 pi, or 360 for angles in degrees.
    """

    joint: int
    rows: np.ndarray
    turn: float


def find_wraps(model: mujoco.MjModel, qpos: np.ndarray) -> list[Wrap]:
    """Hinges whose positions (K, nq) jump by a turn."""
    out = []
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE):
        steps = np.abs(np.diff(qpos[:, int(model.jnt_qposadr[joint])]))
        for turn in (2 * np.pi, 360.0):
            jumps = np.abs(steps - turn) < turn / 4
            others = steps[~jumps]
            if jumps.any() and len(others) and steps[jumps].min() > _OUTLIER * others.max():
                out.append(Wrap(int(joint), np.flatnonzero(jumps) + 1, turn))
                break
    return out


def unwrap_hinges(model: mujoco.MjModel, qpos: np.ndarray, ctrl: np.ndarray, notes: list[str]) -> None:
    """Unwrap hinges without limits in qpos (K, nq), and in ctrl (K, nu) commands of their position servos, in place."""
    for wrap in find_wraps(model, qpos):
        joint, column = wrap.joint, int(model.jnt_qposadr[wrap.joint])
        if model.jnt_limited[joint] or wrap.turn != 2 * np.pi:
            continue
        qpos[:, column] = np.unwrap(qpos[:, column])
        notes.append(
            f"qpos/{part_names(model, 'joint')[joint]} jumped by 2 pi {len(wrap.rows)} times and was unwrapped"
        )
        on_joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
        for actuator in np.flatnonzero(on_joint & (model.actuator_biasprm[:, 1] < 0)):
            gear = float(model.actuator_gear[actuator, 0])
            sent = np.unwrap(ctrl[:, actuator] / gear)
            sent += 2 * np.pi * np.round((np.median(qpos[:, column] - sent)) / (2 * np.pi))
            ctrl[:, actuator] = gear * sent
