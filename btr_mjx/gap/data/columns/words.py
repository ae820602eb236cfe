"""Words in the names of columns: which of them say position, velocity, command or effort, and which say nothing."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


POSITION = _set("q pos position positions qpos angle angles theta phi encoder enc qdes qref qcmd")
VELOCITY = _set("dq qd qdot vel velocity velocities qvel speed speeds omega dtheta thetadot")
EFFORT = _set("tau torque torques effort efforts force forces trq")
COMMAND = _set(
    "cmd command commands commanded ctrl control controls des desired ref reference target targets goal action actions "
    "setpoint setpoints sp u qdes qref qcmd"
)
NEUTRAL = _set(
    "joint joints jnt dof dofs state states motor motors actuator actuators servo servos drive drives observation obs "
    "measured meas measurement actual feedback present data value values msg sensor sensors of the robot"
)
"""Words that say nothing of what a column holds."""
OTHER = _set(
    "acc accel acceleration current currents temperature temperatures temp load voltage voltages power error err "
    "errors raw filtered std var variance min max limit limits status mode flag flags fault enabled id counter"
)
"""Words that say that a column holds something else than what a model needs."""
BASE = _set("base root trunk torso body pelvis odom odometry mocap pose twist link floating free imu vicon optitrack")
"""Words that stand for the free joint of a model that has one."""
ACCELERATION = _set("acc accel acceleration accelerations accelerometer")
"""Words of an accelerometer."""
TIME = ("time", "timestamp", "timestamps", "times", "t", "stamp", "clock", "elapsed")
"""Words for time, in the order of preference."""

_KNOWN = POSITION | VELOCITY | EFFORT | COMMAND | NEUTRAL
_QUATERNION = _set("quat quaternion orientation orient ori rot rotation attitude")
_ANGULAR = _set("angular ang gyro omega angvel")
_LINEAR = _set("linear lin v vel velocity linvel speed")
_PLACE = _set("pos position translation p")
_GYRO = _set("gyro gyroscope gyr")
_IMU = _set("imu ahrs")
_IMU_KINDS: Mapping[str, tuple[frozenset[str], frozenset[str]]] = {
    "accelerometer": (ACCELERATION, _set("linear lin")),
    "magnetometer": (_set("mag magnetometer magnetic"), _set("field")),
    "framequat": (_QUATERNION, frozenset()),
    "gyro": (_GYRO | _set("angular ang angvel omega"), _set("velocity vel rate rates speed")),
}
"""Sensors of an IMU: words of which one has to be there, and others that may be."""


def words(name: str) -> tuple[str, ...]:
    """Words of a name in lower case: "leftHip_q1/pos" is left, hip, q, 1, pos."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
    return tuple(re.findall(r"[^\W\d_]+|\d+", parted))


def kind_of(rest: frozenset[str]) -> tuple[bool, str | None]:
    """Whether words say that a column is a command, and of which quantity: "position", "velocity", "effort" or None."""
    table: Mapping[str, frozenset[str]] = {"velocity": VELOCITY, "effort": EFFORT, "position": POSITION}
    return bool(rest & COMMAND), next((quantity for quantity, known in table.items() if rest & known), None)


def unknown_words(rest: Iterable[str]) -> tuple[str, ...]:
    """The words that are none of those that say what a column holds, or nothing."""
    return tuple(word for word in rest if word not in _KNOWN)


def component(rest: tuple[str, ...]) -> str | None:
    """The suffix of a free joint's column (x, qw, vx, wx, ...) that words name; None if they name none."""
    if not rest:
        return None
    last, others = rest[-1], frozenset(rest[:-1]) - BASE - NEUTRAL
    if re.fullmatch(r"q[wxyz]|[vwp][xyz]", last):
        context = {"q": _QUATERNION | _PLACE, "v": _LINEAR, "w": _ANGULAR | _LINEAR, "p": _PLACE}[last[0]]
        return (last[1] if last[0] == "p" else last) if others <= context else None
    if last not in ("w", "x", "y", "z"):
        return None
    if others & _QUATERNION and others <= _QUATERNION | _PLACE:
        return f"q{last}"
    if last == "w":
        return "qw" if others == {"q"} else None
    if others & _ANGULAR and others <= _ANGULAR | _LINEAR:
        return f"w{last}"
    if others & (_LINEAR - _PLACE) and others <= _LINEAR:
        return f"v{last}"
    return last if others <= _PLACE else f"q{last}" if others == {"q"} else None


@dataclass(frozen=True)
class ImuWords:
    """What words say of a sensor of an IMU.

    Attributes:
      kind: type of MuJoCo's sensor.
      part: component: x, y, z, qw, ...
      explicit: whether they can be nothing of a free joint.
      raw: whether they say that the values were not filtered.
      others: words that may name one of several sensors.
    """

    kind: str
    part: str
    explicit: bool
    raw: bool
    others: frozenset[str]


def imu_words(said: tuple[str, ...], label: tuple[str, ...] = ()) -> ImuWords | None:
    """The sensor of an IMU and its component that words name, in a table with a label; None if they name none.

    Components may be numbers: 0, 1, 2 of a vector, and of a quaternion 0 for w.
    """
    own = frozenset(said[:-1])
    of_imu = bool(_IMU & (own | frozenset(label)))
    for kind, (names, context) in _IMU_KINDS.items():
        quaternion = kind == "framequat" and of_imu and said[-1:] and re.fullmatch("q[wxyz]", said[-1])
        if not own & names and not quaternion:
            continue
        parts = "wxyz" if kind == "framequat" else "xyz"
        axis = {f"q{part}": part for part in parts if len(parts) > 3} | {str(i): p for i, p in enumerate(parts)}
        part = axis.get(said[-1], said[-1])
        if len(part) != 1 or part not in parts:
            return None
        explicit = of_imu or kind in ("accelerometer", "magnetometer") or bool(own & _GYRO)
        others = own - names - context - NEUTRAL - _IMU - {"raw", "lowstate"}
        return ImuWords(kind, part if len(parts) == 3 else f"q{part}", explicit, "raw" in own, others)
    return None
