"""ROS recordings, written by rosbags, against the motion that was written."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from robot_logs import ARM, FLOATER, RobotLog, simulated_log
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data import open_dataset, open_logs

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPE = STORE.types
EPOCH = 1_760_000_000


def header(time: float, frame: str = "") -> Any:
    whole = int(time)
    stamp = TYPE["builtin_interfaces/msg/Time"](sec=EPOCH + whole, nanosec=round(1e9 * (time - whole)))
    return TYPE["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def joint_state(time: float, names: list[str], position: np.ndarray, velocity: np.ndarray) -> Any:
    return TYPE["sensor_msgs/msg/JointState"](
        header=header(time), name=names, position=position, velocity=velocity, effort=np.array([])
    )


def command(values: np.ndarray) -> Any:
    layout = TYPE["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return TYPE["std_msgs/msg/Float64MultiArray"](layout=layout, data=values)


def odometry(time: float, qpos: np.ndarray, qvel: np.ndarray) -> Any:
    """ROS writes x, y, z, w, and the twist in the frame of the child."""
    vector, turn = TYPE["geometry_msgs/msg/Vector3"], np.empty(9)
    mujoco.mju_quat2Mat(turn, qpos[3:7])
    linear = turn.reshape(3, 3).T @ qvel[:3]
    pose = TYPE["geometry_msgs/msg/Pose"](
        position=TYPE["geometry_msgs/msg/Point"](*qpos[:3]),
        orientation=TYPE["geometry_msgs/msg/Quaternion"](x=qpos[4], y=qpos[5], z=qpos[6], w=qpos[3]),
    )
    twist = TYPE["geometry_msgs/msg/Twist"](linear=vector(*linear), angular=vector(*qvel[3:6]))
    return TYPE["nav_msgs/msg/Odometry"](
        header=header(time, "odom"),
        child_frame_id="base_link",
        pose=TYPE["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
        twist=TYPE["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )


def write_bag(folder: Path, messages: list[tuple[float, str, Any]], plugin: StoragePlugin, late: float = 0.0) -> Path:
    with Writer(folder, version=9, storage_plugin=plugin) as bag:
        topics: dict[str, Any] = {}
        for time, topic, message in sorted(messages, key=lambda one: one[0]):
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(topics[topic], round(1e9 * (EPOCH + time + late)), STORE.serialize_cdr(message, kind))
    return folder


def arm_messages(log: RobotLog) -> list[tuple[float, str, Any]]:
    """The joints are named in another order than the model's, commands are not named."""
    joints, sent = log.every(4), log.every(20)
    said = [
        (t, "/joint_states", joint_state(t, ["elbow", "shoulder"], q[::-1].copy(), v[::-1].copy()))
        for t, q, v in zip(joints.time, joints.qpos, joints.qvel, strict=True)
    ]
    return said + [(t, "/arm/commands", command(u)) for t, u in zip(sent.time, sent.ctrl, strict=True)]


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("whole", [True, False])
def test_an_arm_in_both_storages(tmp_path: Path, plugin: StoragePlugin, whole: bool) -> None:
    log = simulated_log(ARM, 1.5, hold=20)
    bag = write_bag(tmp_path / "run", arm_messages(log), plugin)
    (tmp_path / "arm.xml").write_text(ARM)
    file = bag if whole else next(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
    data = open_logs(tmp_path / "arm.xml", [file])
    time = np.concatenate([r.time for r in data.recordings])
    rows = np.round(1000 * time).astype(int)
    assert len(rows) > 350
    np.testing.assert_allclose(np.concatenate([r.qpos for r in data.recordings]), log.qpos[rows], atol=1e-12)
    np.testing.assert_allclose(np.concatenate([r.qvel for r in data.recordings]), log.qvel[rows], atol=1e-12)
    np.testing.assert_array_equal(np.concatenate([r.ctrl for r in data.recordings]), log.ctrl[rows])
    assert data.recordings[0].interpolation == "hold"
    said = " ".join(data.recordings[0].notes)
    assert "command: topic /arm/commands, 75 messages, at the times they were received" in said
    assert "'command/0' to 'command/1' were taken in the order of the model" in said


def test_odometry_becomes_mujocos_state(tmp_path: Path) -> None:
    log = simulated_log(FLOATER, 1.0).every(5)
    messages = [(t, "/odom", odometry(t, q, v)) for t, q, v in zip(log.time, log.qpos, log.qvel, strict=True)]
    messages += [
        (t, "/joint_states", joint_state(t, ["hip"], q[7:], v[6:]))
        for t, q, v in zip(log.time, log.qpos, log.qvel, strict=True)
    ]
    messages += [(t, "/hip_cmd", command(u)) for t, u in zip(log.time, log.ctrl, strict=True)]
    write_bag(tmp_path / "run", messages, StoragePlugin.MCAP)
    (tmp_path / "robot.xml").write_text(FLOATER)
    data = open_dataset(tmp_path)
    assert all(one.qvel_measured.all() for one in data.recordings)
    for name in ("qpos", "qvel"):
        found = np.concatenate([getattr(one, name) for one in data.recordings])
        np.testing.assert_allclose(found, getattr(log, name)[: len(found)], atol=1e-9)
    notes = " ".join(data.recordings[0].notes)
    assert "rotated into the world" in notes
    assert "x, y, z, w were reordered" in notes


def imu(time: float, gyro: np.ndarray, accelerometer: np.ndarray, turn: np.ndarray) -> Any:
    """A message without an orientation has a covariance of -1."""
    vector, nothing = TYPE["geometry_msgs/msg/Vector3"], np.zeros(9)
    return TYPE["sensor_msgs/msg/Imu"](
        header=header(time, "imu_link"),
        orientation=TYPE["geometry_msgs/msg/Quaternion"](x=turn[1], y=turn[2], z=turn[3], w=turn[0]),
        orientation_covariance=nothing if turn.any() else np.r_[-1.0, nothing[1:]],
        angular_velocity=vector(*gyro),
        angular_velocity_covariance=nothing,
        linear_acceleration=vector(*accelerometer),
        linear_acceleration_covariance=nothing,
    )


@pytest.mark.parametrize(("whole", "pose"), [(True, True), (False, True), (False, False)])
def test_imus_are_those_of_the_model(tmp_path: Path, whole: bool, pose: bool) -> None:
    """Two IMUs on different clocks, one of them raw, and of a model without sensors none."""
    log, rng = simulated_log(FLOATER, 1.0).every(5), np.random.default_rng(0)
    sensed = rng.standard_normal((len(log.time), 10)) * (1.0 if whole else np.r_[np.ones(6), np.zeros(4)])
    messages = [(t, "/hip_cmd", command(u)) for t, u in zip(log.time, log.ctrl, strict=True)]
    for t, q, v, s in zip(log.time, log.qpos, log.qvel, sensed, strict=True):
        messages.append((t, "/joint_states", joint_state(t, ["hip"], q[7:], v[6:])))
        messages += [(t, "/odom", odometry(t, q, v))] if pose else []
        messages.append((t, "/imu/data", imu(t, s[:3], s[3:6], s[6:])))
        messages.append((t, "/imu/data_raw", imu(t, 2 * s[:3], 2 * s[3:6], np.zeros(4))))
    write_bag(tmp_path / "run", messages, StoragePlugin.MCAP)
    lines = '<sensor><gyro name="g" site="s"/><accelerometer name="a" site="s"/>{}</sensor>'
    turn = '<framequat name="q" objtype="site" objname="s"/>'
    body = FLOATER.replace('<freejoint name="root"/>', '<freejoint name="root"/><site name="s"/>')
    body = body.replace("<worldbody>", '<worldbody><geom type="plane" size="9 9 1" pos="0 0 -9"/>')
    for text in (body.replace("</worldbody>", f"</worldbody>{lines.format(own)}") for own in (turn, "")):
        (tmp_path / "robot.xml").write_text(text)
        first = open_dataset(tmp_path).recordings[0]
        rows = np.round(200 * first.time).astype(int)
        np.testing.assert_allclose(first.measured_by("g"), sensed[rows, :3], atol=1e-9)
        np.testing.assert_allclose(first.measured_by("a"), sensed[rows, 3:6], atol=1e-9)
        quaternions = first.measured_by("q")
        assert (quaternions is not None) == (whole and text.count("framequat") > 0)
        assert first.sensed.all() == pose
    raw = '[model]\nfile = "robot.xml"\n[[recording]]\nfile = "run"\n[topics]\nimu = "/imu/data_raw"\n'
    (tmp_path / "dataset.toml").write_text(raw)
    np.testing.assert_allclose(open_dataset(tmp_path).recordings[0].measured_by("g"), 2 * sensed[rows, :3], atol=1e-9)
    (tmp_path / "dataset.toml").unlink()
    (tmp_path / "robot.xml").write_text(body)
    if pose:
        notes = " ".join(open_dataset(tmp_path).recordings[0].notes)
        assert "have no use: /imu/data, /imu/data_raw; to have one, add <site" in notes
    else:
        with pytest.raises(InputError, match="there is no column 'qpos/root/x'"):
            open_dataset(tmp_path)


def test_topics_are_asked_for_and_given(tmp_path: Path) -> None:
    log = simulated_log(ARM, 1.0)
    messages = arm_messages(log)
    messages += [(t, "/other_arm/commands", command(-u)) for t, u in zip(log.time[::20], log.ctrl[::20], strict=True)]
    write_bag(tmp_path / "run", messages, StoragePlugin.MCAP)
    (tmp_path / "arm.xml").write_text(ARM)
    with pytest.raises(InputError, match=r"'/arm/commands', '/other_arm/commands' may all be command.*\[topics\]"):
        open_dataset(tmp_path)
    text = '[model]\nfile = "arm.xml"\n[[recording]]\nfile = "run"\n[topics]\ncommand = "{}"\n'
    (tmp_path / "dataset.toml").write_text(text.format("/other_arm/commands"))
    data = open_dataset(tmp_path)
    np.testing.assert_array_equal(data.recordings[0].ctrl[0], -log.ctrl[0])
    (tmp_path / "dataset.toml").write_text(text.format("/nowhere"))
    with pytest.raises(InputError, match=r"command = '/nowhere': there is no such topic; it holds '/arm/commands'"):
        open_dataset(tmp_path)


def test_stamps_of_another_clock_are_not_mixed(tmp_path: Path) -> None:
    """A simulated clock in the stamps, and commands without one: all times are those of reception."""
    log = simulated_log(ARM, 1.0)
    write_bag(tmp_path / "run", arm_messages(log), StoragePlugin.MCAP, late=1000.0)
    (tmp_path / "arm.xml").write_text(ARM)
    data = open_dataset(tmp_path)
    assert any("of another clock" in note for note in data.recordings[0].notes)
    assert sum(len(one.time) for one in data.recordings) >= 249


def test_damaged_bags_are_one_line(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "run", arm_messages(simulated_log(ARM, 0.5)), StoragePlugin.MCAP)
    (tmp_path / "arm.xml").write_text(ARM)
    file = next(bag.glob("*.mcap"))
    content = file.read_bytes()
    for damaged in (content[:300], content[: len(content) // 2], b"no mcap at all", b""):
        other = tmp_path / "other.mcap"
        other.write_bytes(damaged)
        with pytest.raises(DamagedFile, match="not a readable ROS recording") as caught:
            open_logs(tmp_path / "arm.xml", [other])
        assert "\n" not in str(caught.value)
