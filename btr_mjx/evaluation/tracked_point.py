"""The position of a site or body in place of the base's, from recorded configurations."""

import mujoco
import numpy as np

from btr_mjx.engines import Record
from btr_mjx.errors import InputError
from btr_mjx.models import Models, base_model, nearest_names, start_of
from btr_mjx.robots import Robot

_GEOMETRY = ("body_pos", "body_quat", "jnt_pos", "jnt_axis", "site_pos", "site_quat", "qpos0")
"""Fields on which the place of a point depends."""


def point_address(robot: Robot) -> tuple[str, int]:
    """Field of MjData with the position of the robot's `point`, a site or a body, and its row."""
    model = base_model(robot)
    for kind, field in ((mujoco.mjtObj.mjOBJ_SITE, "site_xpos"), (mujoco.mjtObj.mjOBJ_BODY, "xpos")):
        row = mujoco.mj_name2id(model, kind, robot.point)
        if row >= 0:
            return field, row
    names = [model.site(i).name for i in range(model.nsite)] + [model.body(i).name for i in range(1, model.nbody)]
    raise InputError(
        f"point {robot.point!r}: the model has no such site or body; nearest: {nearest_names(robot.point, names)}"
    )


def track_configurations(robot: Robot, qpos: np.ndarray) -> np.ndarray:
    """Positions (K, 3) of the robot's point in configurations (K, nq) of its nominal model [m]."""
    field, row = point_address(robot)
    model = base_model(robot)
    data, out = mujoco.MjData(model), np.empty((len(qpos), 3))
    for k, configuration in enumerate(qpos):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        out[k] = getattr(data, field)[row]
    return out


def track_point(robot: Robot, models: Models, index: np.ndarray, record: Record) -> Record:
    """A record, batch first and with states, whose start and positions are those of the robot's point in the world [m].

    `index` (B,) is the simulation of each pair.
    """
    field, row = point_address(robot)
    fixed = not any(name in models.leaves for name in _GEOMETRY)
    start = start_of(robot)
    origin, position = np.empty((len(index), 3)), np.empty((*record.qpos.shape[:2], 3))
    for simulation in [0] if fixed else np.unique(index).tolist():
        model = models.base if fixed else models.row(simulation)
        data = mujoco.MjData(model)

        def at(qpos: np.ndarray, model: mujoco.MjModel = model, data: mujoco.MjData = data) -> np.ndarray:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            return getattr(data, field)[row].copy()

        pairs = np.arange(len(index)) if fixed else np.flatnonzero(index == simulation)
        origin[pairs] = at(model.qpos0 if start is None else start[0])
        for b in pairs:
            position[b] = [at(qpos) if np.isfinite(qpos).all() else np.nan for qpos in record.qpos[b]]
    return record._replace(start=origin, position=position)
