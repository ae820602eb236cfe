"""Column names of measurement tables: which column of a file is which coordinate of a model.

    time                                                     [s], increasing, not necessarily even
    ctrl/<actuator>                                          command, in the actuator's own unit
    qpos/<joint>, qvel/<joint>                               hinge [rad], [rad/s] or slide [m], [m/s]
    qpos/<joint>/x y z qw qx qy qz                           free joint: position [m] and orientation in the world
    qvel/<joint>/vx vy vz wx wy wz                           free joint: velocity in the world [m/s], angular velocity
                                                             in the body's frame [rad/s], as MuJoCo has them
    qpos/<joint>/qw qx qy qz, qvel/<joint>/wx wy wz          ball joint
    force/<actuator>                                         optional
    sensor/<sensor>                                          optional: touch, joint and actuator sensors
    sensor/<sensor>/x y z                                    gyro [rad/s], accelerometer [m/s^2] and others
    sensor/<sensor>/qw qx qy qz                              framequat
    sensor/<name>                                            anything else, without a use

<sensor> is the name of a `<sensor>` element of the MJCF, whose conventions hold: an accelerometer at rest measures
9.81 m/s^2 upwards.

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
_SENSOR = mujoco.mjtSensor
SENSOR_QUANTITIES: Mapping[int, str | None] = {
    int(_SENSOR.mjSENS_GYRO): "turning",
    int(_SENSOR.mjSENS_ACCELEROMETER): "acceleration",
    int(_SENSOR.mjSENS_VELOCIMETER): "moving",
    int(_SENSOR.mjSENS_FRAMEQUAT): None,
    int(_SENSOR.mjSENS_FRAMEPOS): "length",
    int(_SENSOR.mjSENS_FRAMELINVEL): "moving",
    int(_SENSOR.mjSENS_FRAMEANGVEL): "turning",
    int(_SENSOR.mjSENS_JOINTPOS): "qpos",
    int(_SENSOR.mjSENS_JOINTVEL): "qvel",
    int(_SENSOR.mjSENS_ACTUATORFRC): "force",
    int(_SENSOR.mjSENS_JOINTACTFRC): "force",
    int(_SENSOR.mjSENS_FORCE): "force",
    int(_SENSOR.mjSENS_TORQUE): "force",
    int(_SENSOR.mjSENS_TOUCH): "force",
    int(_SENSOR.mjSENS_MAGNETOMETER): None,
}
"""Types of sensors whose measurements a log can hold, and the quantity of their units; "qpos" and "qvel" are those of
the joint."""
_SENSOR_PARTS: Mapping[int, tuple[str, ...]] = {3: ("/x", "/y", "/z"), 4: tuple(f"/{part}" for part in _QUAT)}


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


def sensor_parts(model: mujoco.MjModel) -> dict[str, list[str]]:
    """Names of the columns of every sensor that a log can hold, by the sensor's name."""
    return {
        name: [f"sensor/{name}{part}" for part in _SENSOR_PARTS.get(int(dim), ("",))]
        for name, kind, dim in zip(part_names(model, "sensor"), model.sensor_type, model.sensor_dim, strict=True)
        if int(kind) in SENSOR_QUANTITIES
    }


def sensor_columns(model: mujoco.MjModel) -> list[str]:
    """Names of the columns of sensors that a log can hold, in the model's order."""
    return [column for columns in sensor_parts(model).values() for column in columns]


def sensor_body(model: mujoco.MjModel, sensor: int) -> int:
    """Id of the body to which a sensor at a site, a body, a geom or a camera is fixed; -1 for other sensors."""
    owner = {
        int(mujoco.mjtObj.mjOBJ_SITE): model.site_bodyid,
        int(mujoco.mjtObj.mjOBJ_GEOM): model.geom_bodyid,
        int(mujoco.mjtObj.mjOBJ_CAMERA): model.cam_bodyid,
        int(mujoco.mjtObj.mjOBJ_BODY): np.arange(model.nbody),
        int(mujoco.mjtObj.mjOBJ_XBODY): np.arange(model.nbody),
    }.get(int(model.sensor_objtype[sensor]))
    return -1 if owner is None else int(owner[model.sensor_objid[sensor]])


def imu_columns(columns: Collection[str], model: mujoco.MjModel, joint: int) -> list[str]:
    """Columns of the gyros and accelerometers that were logged whole and move with the body of a joint.

    There are none unless both kinds were logged.
    """
    found: dict[int, list[str]] = {}
    for name, own in sensor_parts(model).items():
        sensor = part_names(model, "sensor").index(name)
        fixed = model.body_weldid[sensor_body(model, sensor)] == model.body_weldid[model.jnt_bodyid[joint]]
        if fixed and all(column in columns for column in own):
            found.setdefault(int(model.sensor_type[sensor]), []).extend(own)
    kinds = int(_SENSOR.mjSENS_GYRO), int(_SENSOR.mjSENS_ACCELEROMETER)
    return [column for kind in kinds for column in found[kind]] if found.keys() >= {*kinds} else []


def unmeasured_bases(columns: Collection[str], model: mujoco.MjModel) -> list[int]:
    """Ids of the free joints of whose pose no column was logged, but all of a gyro and an accelerometer."""
    return [
        joint
        for joint, name in enumerate(part_names(model, "joint"))
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        and not any(c in ("qpos", f"qpos/{name}") or c.startswith(f"qpos/{name}/") for c in columns)
        and imu_columns(columns, model, joint)
    ]


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
        vectors = groups["qpos"] + groups["qvel"] + sensor_columns(model)
        members = groups.get(name) or [c for c in vectors if c.startswith(f"{name}/")] or [name]
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


def check_sensors(columns: Collection[str], model: mujoco.MjModel, where: str) -> None:
    """Refuse columns of a sensor of the model that are none of its components, and a part of its components only."""
    known, columns = sensor_columns(model), [c for c in columns if c.startswith("sensor/")]
    for name, own in sensor_parts(model).items():
        for column in columns:
            if column not in known and f"{column}/".startswith(f"sensor/{name}/"):
                raise InputError(
                    f"{where}: column {column!r} is no component of the sensor {name!r}; expected {listed(own)}"
                )
        missing = [c for c in own if c not in columns]
        if 0 < len(missing) < len(own):
            raise InputError(f"{where}: there is no column {missing[0]!r}; give all columns of a sensor or none")


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
    check_sensors(columns, model, where)
    useful = {"time"}.union(*families.values())
    return [c for c in columns if c not in useful and not c.startswith("sensor/")]
