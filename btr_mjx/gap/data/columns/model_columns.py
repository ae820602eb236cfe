"""Column names of measurement tables: which column of a file is which coordinate of a model.

    time                                                     [s], increasing, not necessarily even
    ctrl/<actuator>                                          command, in the actuator's own unit
    qpos/<joint>, qvel/<joint>                               hinge [rad], [rad/s] or slide [m], [m/s]
    qpos/<joint>/x y z qw qx qy qz                           free joint: position [m] and orientation in the world
    qvel/<joint>/vx vy vz wx wy wz                           free joint: velocity in the world [m/s], angular velocity
                                                             in the body's frame [rad/s], as MuJoCo has them
    qpos/<joint>/qw qx qy qz, qvel/<joint>/wx wy wz          ball joint
    force/<actuator>, sensor/<name>                          optional

CSV, Parquet and NPZ files hold these columns. In NPZ, arrays `qpos` (K, nq), `qvel` (K, nv) and `ctrl` (K, nu) may
stand for all columns of their kind, and `qpos/<joint>` (K, 7) for those of a free joint.
"""

from collections.abc import Collection, Iterable, Mapping

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import nearest_names, part_names

_QUAT, _SPIN = ("qw", "qx", "qy", "qz"), ("wx", "wy", "wz")
SUFFIXES: Mapping[int, tuple[tuple[str, ...], tuple[str, ...]]] = {
    int(mujoco.mjtJoint.mjJNT_FREE): (("x", "y", "z", *_QUAT), ("vx", "vy", "vz", *_SPIN)),
    int(mujoco.mjtJoint.mjJNT_BALL): (_QUAT, _SPIN),
}
"""Suffixes of the position and velocity columns by joint type; hinges and slides have one column without suffix."""


def state_columns(model: mujoco.MjModel) -> tuple[list[str], list[str]]:
    """Names of the nq columns of qpos and of the nv columns of qvel, in the model's order."""
    positions, velocities = [], []
    for name, kind in zip(part_names(model, "joint"), model.jnt_type, strict=True):
        q, v = SUFFIXES.get(int(kind), ((), ()))
        positions += [f"qpos/{name}/{part}" for part in q] or [f"qpos/{name}"]
        velocities += [f"qvel/{name}/{part}" for part in v] or [f"qvel/{name}"]
    return positions, velocities


def control_columns(model: mujoco.MjModel) -> list[str]:
    """Names of the nu columns of ctrl, in the model's order."""
    return [f"ctrl/{name}" for name in part_names(model, "actuator")]


def model_columns(model: mujoco.MjModel) -> dict[str, list[str]]:
    """Names of all columns of a model, by what they begin with: qpos, qvel, ctrl, force."""
    (positions, velocities), controls = state_columns(model), control_columns(model)
    forces = [name.replace("ctrl/", "force/", 1) for name in controls]
    return {"qpos": positions, "qvel": velocities, "ctrl": controls, "force": forces}


def driven_joint(model: mujoco.MjModel, actuator: int) -> int | None:
    """Id of the joint on which an actuator acts; None for a tendon, a site or a body."""
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return int(model.actuator_trnid[actuator, 0]) if int(model.actuator_trntype[actuator]) in kinds else None


def ungroup_columns(columns: Mapping[str, np.ndarray], model: mujoco.MjModel, where: str) -> dict[str, np.ndarray]:
    """Split grouped arrays (K, n), as `readers.read_columns` returns them, into single columns (K,)."""
    groups = model_columns(model)
    flat: dict[str, np.ndarray] = {}
    for name, array in columns.items():
        if array.ndim == 1 and name not in groups:
            flat[name] = array
            continue
        array = array.reshape(len(array), -1)
        members = groups.get(name) or [c for c in groups["qpos"] + groups["qvel"] if c.startswith(f"{name}/")] or [name]
        if array.shape[1] != len(members):
            raise InputError(
                f"{where}: array {name!r} has {array.shape[1]} columns, the model needs {len(members)}: "
                f"{listed(members)}"
            )
        flat |= dict(zip(members, array.T, strict=True))
    return flat


def check_spelling(columns: Iterable[str], model: mujoco.MjModel, where: str) -> None:
    """Refuse columns that begin like those of a model and are none of its own, with the nearest names."""
    known = model_columns(model)
    for column in columns:
        kind = column.partition("/")[0]
        if "/" in column and kind in known and column not in known[kind]:
            what = "actuator" if kind in ("ctrl", "force") else "joint"
            near = nearest_names(column, known[kind])
            raise InputError(f"{where}: column {column!r} names no {what} of the model; nearest: {near}")


def check_velocities(columns: Collection[str], model: mujoco.MjModel, where: str) -> None:
    """Refuse columns that have some of a joint's velocities only."""
    velocities = state_columns(model)[1]
    for name in part_names(model, "joint"):
        of_joint = [c for c in velocities if c == f"qvel/{name}" or c.startswith(f"qvel/{name}/")]
        missing = [c for c in of_joint if c not in columns]
        if 0 < len(missing) < len(of_joint):
            raise InputError(f"{where}: there is no column {missing[0]!r}; give all of a joint's velocities or none")


def check_names(columns: Collection[str], model: mujoco.MjModel, where: str) -> list[str]:
    """Names of columns that are not used; refuses unknown ones of joints and actuators, and missing ones."""
    check_spelling(columns, model, where)
    families = model_columns(model)
    # A joint without any column has no encoder, see `unmeasured`.
    joints = part_names(model, "joint")
    begun = {name for name in joints if any(c == f"qpos/{name}" or c.startswith(f"qpos/{name}/") for c in columns)}
    needed = [c for c in families["qpos"] if any(f"{c}/".startswith(f"qpos/{name}/") for name in begun)]
    for column in ["time", *needed, *families["ctrl"]]:
        if column not in columns:
            near = nearest_names(column, list(columns))
            raise InputError(f"{where}: there is no column {column!r}; nearest in the file: {near}")
    check_velocities(columns, model, where)
    useful = {"time"}.union(*families.values())
    return [c for c in columns if c not in useful and not c.startswith("sensor/")]
