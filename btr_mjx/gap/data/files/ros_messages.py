"""What each type of ROS message says: numbers by name, in MuJoCo's conventions of quaternions."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

Numbers = Mapping[str, float]

JOINTS = ("sensor_msgs/msg/JointState",)
COMMANDS = (
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/Float32MultiArray",
    "trajectory_msgs/msg/JointTrajectory",
    *JOINTS,
)
POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/TransformStamped",
)
TWISTS = (
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "geometry_msgs/msg/Twist",
)
IMUS = ("sensor_msgs/msg/Imu",)
IMU_FIELDS = {"angular_velocity": "gyro", "linear_acceleration": "accelerometer", "orientation": "framequat"}
"""Kinds of the sensors that a message of an IMU holds, by field."""
WORLD_FRAMES = ("map", "odom", "world", "earth", "mocap", "vicon", "optitrack")
"""Frames that do not move with the robot."""


def joint_numbers(message: Any, role: str) -> Numbers:
    """Positions, velocities and efforts of a JointState, as far as it has them."""
    return _by_joint(role, message.name, (message.position, message.velocity, message.effort))


def command_numbers(message: Any) -> Numbers:
    """Numbers of a command: an array by number, a trajectory's first point and a JointState by name of the joint."""
    if hasattr(message, "joint_names"):
        first = [(point.positions, point.velocities, point.effort) for point in message.points[:1]]
        return _by_joint("command", message.joint_names, first[0]) if first else {}
    if hasattr(message, "name"):
        return joint_numbers(message, "command")
    return {f"command/{i}": float(value) for i, value in enumerate(message.data)}


def _by_joint(role: str, names: Sequence[str], rows: Sequence[Sequence[float]]) -> Numbers:
    return {
        f"{role}/{quantity}/{name}": float(value)
        for quantity, values in zip(("position", "velocity", "effort"), rows, strict=True)
        if len(values) == len(names)
        for name, value in zip(names, values, strict=True)
    }


def pose_numbers(message: Any) -> Numbers:
    """Position and orientation of the base: ROS writes quaternions as x, y, z, w."""
    pose = getattr(message, "transform", None) or getattr(message, "pose", message)
    pose = getattr(pose, "pose", pose)  # with covariance
    place = getattr(pose, "translation", None) or pose.position
    turn = getattr(pose, "rotation", None) or pose.orientation
    return {
        **{f"base/{axis}": float(getattr(place, axis)) for axis in "xyz"},
        **{f"base/q{axis}": float(getattr(turn, axis)) for axis in "wxyz"},
    }


def twist_numbers(message: Any) -> Numbers:
    """Velocity and angular velocity of the base, in the frame of the message."""
    twist = getattr(message, "twist", message)
    twist = getattr(twist, "twist", twist)
    return {
        **{f"base/v{axis}": float(getattr(twist.linear, axis)) for axis in "xyz"},
        **{f"base/w{axis}": float(getattr(twist.angular, axis)) for axis in "xyz"},
    }


def imu_numbers(message: Any, topic: str, kinds: Collection[str]) -> Numbers:
    """Angular velocity, acceleration and orientation of an Imu, those of these kinds of sensors that it knows."""
    found: dict[str, float] = {}
    for name, kind in IMU_FIELDS.items():
        values = {
            axis: float(value) for axis in "wxyz" if (value := getattr(getattr(message, name), axis, None)) is not None
        }
        absent = getattr(message, f"{name}_covariance")[0] == -1 or (kind == "framequat" and not any(values.values()))
        if kind in kinds and not absent:
            found |= {f"{topic}/{name}/{axis}": value for axis, value in values.items()}
    return found


def frame_of(message: Any) -> str:
    """The frame in which a message is written; "" where it has no header."""
    header = getattr(message, "header", None)
    return "" if header is None else str(header.frame_id).strip("/")


def stamp_of(message: Any) -> int | None:
    """Time stamp [ns]; None where a message has no header or leaves it empty."""
    header = getattr(message, "header", None)
    if header is None:
        return None
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec) or None
