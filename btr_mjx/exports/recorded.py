"""Curves over time and poses of bodies, as files for viewers of recordings show them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.models import part_names


@dataclass(frozen=True, eq=False)
class RecordedCurves:
    """Numbers over time, measured or simulated.

    Attributes:
      group: those of the same group and coordinate are compared.
      name: whose numbers they are, such as "measured".
      time: (K,) [s].
      values: (K,) by coordinate, NaN where there is none.
      units: by coordinate.
    """

    group: str
    name: str
    time: np.ndarray
    values: Mapping[str, np.ndarray]
    units: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class RecordedPoses:
    """Poses in the world of all bodies of a robot.

    Attributes:
      name: whose motion it is, such as "measured".
      time: (F,) [s].
      bodies: (B,) names, without the world.
      positions: (F, B, 3) [m].
      quaternions: (F, B, 4), w x y z.
      boxes: of each body the boxes around its geoms in its frame (n, 10): centre, half sizes, quaternion.
    """

    name: str
    time: np.ndarray
    bodies: Sequence[str]
    positions: np.ndarray
    quaternions: np.ndarray
    boxes: Sequence[np.ndarray]


def recorded_poses(name: str, model: mujoco.MjModel, time: np.ndarray, qpos: np.ndarray) -> RecordedPoses:
    """Poses of the bodies of a model.

    Args:
      name: whose motion it is.
      model: the model.
      time: (F,) [s].
      qpos: (F, nq) finite generalised positions.
    """
    data = mujoco.MjData(model)
    positions, quaternions = np.empty((len(qpos), model.nbody, 3)), np.empty((len(qpos), model.nbody, 4))
    for k, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        positions[k], quaternions[k] = data.xpos, data.xquat
    bodies = part_names(model, "body")[1:]
    boxes = [_boxes(model, body) for body in range(1, model.nbody)]
    return RecordedPoses(name, time, bodies, positions[:, 1:], quaternions[:, 1:], boxes)


def _boxes(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Boxes (n, 10) around the geoms of a body."""
    own = np.flatnonzero(model.geom_bodyid == body)
    out = np.concatenate([model.geom_pos[own], model.geom_aabb[own, 3:], model.geom_quat[own]], axis=1)
    for row, offset in zip(out, model.geom_aabb[own, :3], strict=True):
        turned = np.empty(3)
        mujoco.mju_rotVecQuat(turned, offset, row[6:])
        row[:3] += turned
    return out
