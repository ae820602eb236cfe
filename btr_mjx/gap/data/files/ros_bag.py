"""ROS recordings: MCAP files, rosbag2 folders (MCAP or SQLite), ROS 1 bags.

Every topic is a table with its own clock. Topics are those named in dataset.toml, else the only one of their type:

    [topics]
    joint_states = "/joint_states"      # sensor_msgs/JointState
    command = "/arm/commands"           # Float64MultiArray, JointTrajectory or JointState
    base = "/odom"                      # Odometry, Pose, PoseStamped or TransformStamped, of a free joint
    base_velocity = "/velocity"         # Twist or TwistStamped, where the base has no Odometry
    imu = "/imu/data"                   # Imu, for sensors of the model; all of them where none is named

Quaternions change from x, y, z, w to w, x, y, z. The twist of an Odometry is in the frame of the child: its linear part
is rotated into the world, its angular part stays, as in MuJoCo.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import DamagedFile, InputError, one_line
from btr_mjx.gap.data.columns.imu_names import ImuNames
from btr_mjx.gap.data.columns.words import COMMAND, words
from btr_mjx.gap.data.files.ros_messages import (
    COMMANDS,
    IMU_FIELDS,
    IMUS,
    JOINTS,
    POSES,
    TWISTS,
    WORLD_FRAMES,
    command_numbers,
    frame_of,
    imu_numbers,
    joint_numbers,
    pose_numbers,
    stamp_of,
    twist_numbers,
)
from btr_mjx.gap.data.files.table import LogTable, check_log_size, log_table, missing_extra
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import sign_flips

TOPICS: Mapping[str, Sequence[str]] = {
    "joint_states": JOINTS,
    "command": COMMANDS,
    "base": POSES,
    "base_velocity": TWISTS,
    "imu": IMUS,
}
"""Types of messages by key of [topics]."""
_USUAL = {"joint_states": "/joint_states", "base": "/odom"}
"""Topic that is taken where there are several of its type."""
_TWIST = [f"base/{kind}{axis}" for kind in "vw" for axis in "xyz"]
_LATE = 0.5
"""Seconds between stamp and reception beyond which they are of different clocks."""


@dataclass
class _Topic:
    """Messages of a topic with the same names."""

    role: str
    topic: str
    received: list[int]
    stamps: list[int | None]
    rows: list[Sequence[float]]
    names: tuple[str, ...]
    frame: str


def is_ros_folder(path: Path) -> bool:
    """Whether a path is the folder of a rosbag2 recording."""
    return (path / "metadata.yaml").is_file()


def read_ros(
    path: Path, topics: Mapping[str, str] | None = None, model: mujoco.MjModel | None = None
) -> list[LogTable]:
    """Read the topics of a recording: a table for each, and for each set of joints that its messages name.

    `topics` are chosen ones by key of `TOPICS`; a model decides which others are needed, without one it is all.

    `topics` are chosen ones by key of `TOPICS`; a model decides which others are needed, without one it is all.
    """
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    check_log_size(sum(file.stat().st_size for file in files), path)
    try:
        with _opened(path) as reader:
            types = {name: str(about.msgtype) for name, about in reader.topics.items() if about.msgcount}
            roles = _roles(types, topics or {}, model, path)
            imus = [topic for topic, kind in types.items() if kind in IMUS and roles.get("imu", topic) == topic]
            kinds = set(IMU_FIELDS.values()) if model is None else set(ImuNames.of(model).sensors)
            every = {topic: role for role, topic in roles.items()} | dict.fromkeys(imus if kinds else [], "imu")
            found = _read_topics(reader, every, kinds)
            lacking = (
                [] if model is None else ImuNames.of(model).without_sensor(dict.fromkeys(IMU_FIELDS.values(), imus))
            )
    except InputError:
        raise
    except Exception as error:  # the readers of the storages raise many types of errors for damaged bytes
        raise DamagedFile(f"{path}: not a readable ROS recording ({one_line(error)})") from None
    return _tables(path, found, lacking if imus else [])


def count_messages(path: Path) -> int:
    """Largest number of messages of a topic."""
    with _opened(path) as reader:
        return max((int(about.msgcount) for about in reader.topics.values()), default=0)


def _opened(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise missing_extra(path, "ros") from None
    return AnyReader([path], default_typestore=get_typestore(Stores.LATEST))


def _roles(
    types: Mapping[str, str], given: Mapping[str, str], model: mujoco.MjModel | None, path: Path
) -> dict[str, str]:
    """Topic by role: as given, else the only one of the role's types."""
    needed = dict.fromkeys(TOPICS, True)
    if model is not None:
        free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
        needed = {"joint_states": not free.all(), "command": model.nu > 0, "base": free.any()}
        needed["base_velocity"] = needed["base"]
    needed["imu"] = False  # all of them are read
    chosen: dict[str, str] = {}
    for role, known in TOPICS.items():
        if role in given:
            if given[role] not in types:
                raise InputError(
                    f"{path}: [topics] {role} = {given[role]!r}: there is no such topic; it holds "
                    f"{listed(sorted(types), quotes=True)}"
                )
            if types[given[role]] not in known:
                raise InputError(
                    f"{path}: [topics] {role} = {given[role]!r}: holds {types[given[role]]}, expected "
                    f"{' or '.join(known)}"
                )
            chosen[role] = given[role]
            continue
        fits = [topic for topic in types if types[topic] in known and topic not in given.values()]
        if role in ("joint_states", "command"):
            commanding = role == "command"
            fits = [t for t in fits if types[t] not in JOINTS or bool(COMMAND & set(words(t))) == commanding]
        if role == "base_velocity":
            fits = [topic for topic in fits if not COMMAND & set(words(topic))]
            if types.get(chosen.get("base", "")) == "nav_msgs/msg/Odometry":
                continue
        if role in _USUAL and _USUAL[role] in fits:
            fits = [_USUAL[role]]
        if len(fits) > 1 and needed[role]:
            raise InputError(
                f"{path}: {listed(sorted(fits), quotes=True)} may all be {role}; say which in "
                f'dataset.toml:  [topics]  {role} = "{sorted(fits)[0]}"'
            )
        if fits and needed[role]:
            chosen[role] = fits[0]
    if "joint_states" not in chosen and needed["joint_states"]:
        held = listed(f"{topic} ({kind})" for topic, kind in sorted(types.items()))
        raise InputError(f"{path}: no topic holds sensor_msgs/msg/JointState; it holds {held or 'no messages'}")
    return chosen


_READERS: Mapping[str, Callable[[Any], Mapping[str, float]]] = {
    "joint_states": lambda message: joint_numbers(message, "joint_states"),
    "command": command_numbers,
    "base": pose_numbers,
    "base_velocity": twist_numbers,
}


def _read_topics(reader: Any, roles: Mapping[str, str], kinds: Collection[str]) -> list[_Topic]:
    found: dict[tuple[str, tuple[str, ...]], _Topic] = {}
    connections = [one for one in reader.connections if one.topic in roles]
    for connection, received, raw in reader.messages(connections=connections):
        message, role = reader.deserialize(raw, connection.msgtype), roles[connection.topic]
        one_imu = role == "imu"
        numbers = dict(imu_numbers(message, connection.topic, kinds) if one_imu else _READERS[role](message))
        if role == "base" and hasattr(message, "child_frame_id") and hasattr(message, "twist"):
            numbers |= {f"child/{name}": value for name, value in twist_numbers(message).items()}
        names = tuple(numbers)
        if not names:
            continue
        if (role, names) not in found:
            found[role, names] = _Topic(role, connection.topic, [], [], [], names, frame_of(message))
        one = found[role, names]
        one.received.append(int(received))
        one.stamps.append(stamp_of(message))
        one.rows.append(tuple(numbers.values()))
    return list(found.values())


def _tables(path: Path, topics: Sequence[_Topic], told: Sequence[str]) -> list[LogTable]:
    stamped = [None if None in one.stamps else np.array(one.stamps, np.int64) for one in topics]  # [ns]
    notes = list(told)
    late = [
        one.topic
        for one, stamps in zip(topics, stamped, strict=True)
        if stamps is not None and abs(float(np.median(np.array(one.received) - stamps))) > _LATE * 1e9
    ]
    if late and any(stamps is None for stamps in stamped):
        notes.append(
            f"time stamps of {late[0]} are of another clock than those without stamps: reception counts for all"
        )
        stamped = [None] * len(topics)
    times = [np.array(t.received) if s is None else s for t, s in zip(topics, stamped, strict=True)]
    origin = min((int(time[0]) for time in times), default=0)
    pieces = []
    for one, stamps, time in zip(topics, stamped, times, strict=True):
        order = np.argsort(time, kind="stable")
        fresh = np.concatenate([[True], np.diff(time[order]) > 0])
        if not fresh.all():
            notes.append(f"{one.topic}: {int((~fresh).sum())} messages with the time stamp of another one left out")
        rows = order[fresh]
        values = np.array(one.rows, float)[rows]
        columns = {"time": 1e-9 * (time[rows] - origin), **dict(zip(one.names, values.T, strict=True))}
        clock = "received" if stamps is None else "stamped"
        notes.append(f"{one.role}: topic {one.topic}, {len(rows)} messages, at the times they were {clock}")
        pieces.append((one, columns))
    _turn_velocities(pieces, notes)
    tables = [log_table(path, one.role, columns) for one, columns in pieces]
    return [replace(table, notes=tuple(dict.fromkeys(notes))) for table in tables]


def _turn_velocities(pieces: Sequence[tuple[_Topic, dict[str, np.ndarray]]], notes: list[str]) -> None:
    """Bring velocities of the base into MuJoCo's frames, in place: linear in the world, angular in the body."""
    pose = next((columns for one, columns in pieces if one.role == "base"), None)
    for one, columns in pieces:
        if one.role == "base" and "child/base/vx" in columns:
            moving = {name: columns.pop(f"child/{name}") for name in _TWIST}
            if any(values.any() for values in moving.values()):  # many trackers leave the twist empty
                columns |= _turned(moving, columns, columns["time"], "v", inverse=False)
                notes.append(
                    f"{one.topic}: the twist is in the child's frame; its linear part was rotated into the world"
                )
        elif one.role == "base_velocity" and pose is not None:
            moving = {name: columns.pop(name) for name in _TWIST}
            world = one.frame in WORLD_FRAMES
            columns |= _turned(moving, pose, columns["time"], "w" if world else "v", inverse=world)
            part = "angular part was rotated into the body" if world else "linear part was rotated into the world"
            notes.append(f"{one.topic}: the twist is in the frame {one.frame or 'of the body'!r}; its {part}")
    notes += ["quaternions x, y, z, w were reordered to w, x, y, z"] if pose is not None else []


def _turned(
    moving: Mapping[str, np.ndarray], pose: Mapping[str, np.ndarray], time: np.ndarray, kind: str, inverse: bool
) -> dict[str, np.ndarray]:
    """Velocities with one part rotated by the orientation of the base at these times, or by its inverse."""
    quat = np.stack([pose[f"base/q{axis}"] for axis in "wxyz"], axis=1)
    quat *= sign_flips(quat)[:, None]
    between = np.stack([np.interp(time, pose["time"], part) for part in quat.T])
    w, *axis = between / np.linalg.norm(between, axis=0)  # not of scipy: a tracker may write zeros, which is told later
    u, vector = np.stack(axis) * (-1 if inverse else 1), np.stack([moving[f"base/{kind}{part}"] for part in "xyz"])
    cross = 2 * np.cross(u, vector, axis=0)
    turned = vector + w * cross + np.cross(u, cross, axis=0)
    return dict(moving) | {f"base/{kind}{part}": row for part, row in zip("xyz", turned, strict=True)}
