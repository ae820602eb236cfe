"""Vectors and poses of which a log has some columns only: what was matched by name is left out, or is a sensor's."""

from collections.abc import Sequence

import mujoco

from btr_mjx.gap.data.columns.imu_names import IMU_SENSORS
from btr_mjx.gap.data.columns.model_columns import (
    SUFFIXES,
    imu_columns,
    model_columns,
    sensor_body,
    sensor_parts,
)
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import part_names

Names = dict[tuple[int, str], str]
"""Column of the model, by number of the table and name in the table."""


def keep_whole_groups(names: Names, model: mujoco.MjModel, notes: list[str]) -> None:
    """Leave out, in place, velocities and sensors without all components, and orientations without a place.

    What has MuJoCo's own names stays, so that it is refused. A gyroscope alone is not the velocity of a free joint, and
    an orientation alone not its pose: they are those of the model's sensors, where it has them.
    """
    for name, own in sensor_parts(model).items():
        found = _matched(names, own)
        if 0 < len(found) < len(own):
            _leave_out(names, found)
            notes.append(f"sensor {name} is not used: there are {len(found)} columns, without {_absent(found, own)}")
    free = mujoco.mjtJoint.mjJNT_FREE
    for joint, (name, kind) in enumerate(zip(part_names(model, "joint"), model.jnt_type, strict=True)):
        if int(kind) not in SUFFIXES:
            continue
        velocities = [c for c in model_columns(model)["qvel"] if c.startswith(f"qvel/{name}/")]
        found = _matched(names, velocities)
        if 0 < len(found) < len(velocities):
            _leave_out(names, found)
            absent = _absent(found, velocities)
            notes.append(f"velocities of {name} are estimated: there are {len(found)} columns, without {absent}")
            _give_to_sensor(names, found, velocities[3:], "gyro", model, joint, notes)
        places = [f"qpos/{name}/{part}" for part in SUFFIXES[int(kind)][0]]
        found = _matched(names, places)
        turned = bool(found) and set(found.values()) <= set(places[3:])
        if kind == free and turned and imu_columns(set(names.values()), model, joint):
            _leave_out(names, found)
            notes.append(
                f"{listed(key[1] for key in found)}: an orientation without a position is no pose; it is that of a "
                "sensor <framequat> at the site of the IMU, if the model has one"
            )
            _give_to_sensor(names, found, places[3:], "framequat", model, joint, notes)


def _matched(names: Names, group: Sequence[str]) -> Names:
    """The matches of a group of columns; none where one has its own name."""
    found = {key: target for key, target in names.items() if target in group}
    return {} if any(key[1] == target for key, target in found.items()) else found


def _leave_out(names: Names, found: Names) -> None:
    for key in found:
        del names[key]


def _absent(found: Names, group: Sequence[str]) -> str:
    return ", ".join(sorted(set(group) - set(found.values())))


def _give_to_sensor(
    names: Names,
    found: Names,
    group: Sequence[str],
    kind: str,
    model: mujoco.MjModel,
    joint: int,
    notes: list[str],
) -> None:
    """Make a whole group of a free joint's columns that of the only such sensor of its body, if there is one."""
    sensors = part_names(model, "sensor")
    own = [
        columns
        for name, columns in sensor_parts(model).items()
        if IMU_SENSORS.get(int(model.sensor_type[i := sensors.index(name)])) == kind
        and model.body_weldid[sensor_body(model, i)] == model.body_weldid[model.jnt_bodyid[joint]]
    ]
    angular = {key: target for key, target in found.items() if target in group}
    if len(own) == 1 and len(angular) == len(group) and not set(own[0]) & set(names.values()):
        names |= {key: own[0][list(group).index(target)] for key, target in angular.items()}
        sensor = own[0][0][7:].rpartition("/")[0]
        notes.append(f"{listed(key[1] for key in angular)} are those of the sensor {sensor}")
