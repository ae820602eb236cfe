"""Columns of IMUs: which sensor of a model they are, and a base whose pose nothing else tells."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from imu_logs import POSE, SENSORS, quadruped, walk
from robot_logs import FLOATER

from btr_mjx.errors import InputError
from btr_mjx.gap.data import base_unmeasured, make_recording, open_logs, save_dataset, sensor_columns
from btr_mjx.gap.data.columns.matching import match_columns
from btr_mjx.gap.data.columns.required import check_matched
from btr_mjx.gap.data.columns.units import ColumnUnit, conversion, stated_unit

Columns = dict[str, np.ndarray]
SITE = '<freejoint name="root"/><site name="imu"/>'


def robot(sensors: str = SENSORS) -> mujoco.MjModel:
    text = FLOATER.replace('<freejoint name="root"/>', SITE).replace("</worldbody>", f"</worldbody>{sensors}")
    return mujoco.MjModel.from_xml_string(text)


ROBOT = robot()
JOINTS = ["time", "hip", "hip_cmd"]
PLACE = [f"base_{axis}" for axis in "xyz"]


def names_of(columns: list[str], model: mujoco.MjModel = ROBOT) -> tuple[dict[str, str], str]:
    """Matches of all but the joint's columns, and the notes."""
    found = match_columns([("log", [*JOINTS, *columns])], model, {}, "log.csv")
    return {c: t for (_, c), t in found.names.items() if c not in JOINTS}, " ".join(found.notes)


def unit(text: str) -> ColumnUnit:
    found = ColumnUnit.of(text)
    assert found is not None
    return found


def sensors_of(form: str, sensor: str, names: str, parts: str) -> Columns:
    prefix = "q" if len(parts) > 3 else ""
    return {form.format(n): f"sensor/{sensor}/{prefix}{p}" for n, p in zip(names, parts, strict=True)}


def test_columns_follow_the_model() -> None:
    scalar = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="a"/><geom size="1"/><site name="s"/></body></worldbody><sensor>'
        '<touch name="toe" site="s"/><clock name="clock"/><framequat name="turn" objtype="site" objname="s"/>'
        '<jointvel name="speed" joint="a"/></sensor></mujoco>'
    )
    turn = [f"sensor/turn/{part}" for part in ("qw", "qx", "qy", "qz")]
    assert sensor_columns(scalar) == ["sensor/toe", *turn, "sensor/speed"]
    assert conversion("sensor/speed", unit("deg/s"), scalar, "x") == pytest.approx(np.pi / 180)


@pytest.mark.parametrize(
    ("gyro", "accelerometer", "quaternion"),
    [
        ("angular_velocity.{}", "linear_acceleration.{}", "orientation.{}"),
        ("/imu/data/angular_velocity/{}", "/imu/data/linear_acceleration/{}", "/imu/data/orientation/{}"),
        ("imu_gyroscope[{}]", "imu_accelerometer[{}]", "imu_quaternion[{}]"),
        (
            "lowstate.imu_state.gyroscope[{}]",
            "lowstate.imu_state.accelerometer[{}]",
            "lowstate.imu_state.quaternion[{}]",
        ),
        ("observation.imu.gyro.{}", "observation.imu.accel.{}", "observation.imu.quat.{}"),
        ("gyro_{}", "acc_{}", "quat_{}"),
        ("gyro_{} [dps]", "accel_{}_g", "imu_q{}"),
        ("sensor/imu_gyro/{}", "sensor/imu_acc/{}", "imu_quat_{}"),
        ("imu_gyro_{}_rad_s", "imu_acc_{}_m/s^2", "imu_orientation_{}"),
    ],
)
def test_names_of_the_field(gyro: str, accelerometer: str, quaternion: str) -> None:
    numbers = "[{}]" in gyro
    expected = sensors_of(gyro, "imu_gyro", "012" if numbers else "xyz", "xyz")
    expected |= sensors_of(accelerometer, "imu_acc", "012" if numbers else "xyz", "xyz")
    expected |= sensors_of(quaternion, "imu_quat", "0123" if numbers else "wxyz", "wxyz")
    assert names_of([*expected, "imu.rpy[0]", "imu_temperature", "gyro_bias_x", "imu_time_offset"])[0] == expected


def test_poses_stay_those_of_the_free_joint() -> None:
    for turn in ("base_quat_{}", "odom/pose/pose/orientation/{}", "q{}", "mocap_quat_{}"):
        pose = {name: f"qpos/root/{axis}" for name, axis in zip(PLACE, "xyz", strict=True)}
        pose |= {turn.format(axis): f"qpos/root/q{axis}" for axis in "wxyz"}
        imu = sensors_of("imu_quat_{}", "imu_quat", "wxyz", "wxyz") | sensors_of(
            "imu_gyro_{}", "imu_gyro", "xyz", "xyz"
        )
        assert names_of([*pose, *imu])[0] == pose | imu
    for model in (mujoco.MjModel.from_xml_string(FLOATER), robot(SENSORS[: SENSORS.index("<framequat")] + "</sensor>")):
        pose = dict(zip(PLACE, POSE[:3], strict=True)) | {f"imu_quat_{a}": f"qpos/root/q{a}" for a in "wxyz"}
        assert names_of(list(pose), model)[0] == pose


def test_velocities_of_a_free_joint_stay_where_they_are_whole() -> None:
    whole = {f"base_{kind}_vel_{a}": f"qvel/root/{p}{a}" for kind, p in (("lin", "v"), ("ang", "w")) for a in "xyz"}
    gyro = sensors_of("gyro_{}", "imu_gyro", "xyz", "xyz")
    assert names_of([*whole, *gyro])[0] == whole | gyro


def test_of_two_imus_words_decide() -> None:
    site = '<gyro name="{0}_gyro" site="imu"/>'
    two = robot(f"<sensor>{site.format('front')}{site.format('rear')}</sensor>")
    front, rear = (sensors_of(f"{side}_imu/gyro/{{}}", f"{side}_gyro", "xyz", "xyz") for side in ("front", "rear"))
    assert names_of([*front, *rear], two)[0] == front | rear
    found, notes = names_of([f"gyro_{axis}" for axis in "xyz"], two)
    assert found == {}
    assert "may be of front_gyro or rear_gyro; say which in [columns]" in notes
    found, notes = names_of([f"{side}/angular_velocity/{a}" for side in ("imu", "base/imu") for a in "xyz"])
    assert found == {}
    assert "may be of imu_gyro" in notes
    assert names_of([f"imu2/gyro/{axis}" for axis in "xyz"])[0] == {}


def test_a_model_without_an_imu_gets_lines_to_add() -> None:
    columns = [f"imu_{kind}_{axis}" for kind in ("gyro", "acc") for axis in "xyz"]
    found, notes = names_of(columns, mujoco.MjModel.from_xml_string(FLOATER))
    assert found == {}
    assert "<site name=\"imu\"/> to the body 'trunk'" in notes
    lines = notes[notes.index("<sensor>") : notes.index("</sensor>") + len("</sensor>")]
    assert set(names_of(columns, robot(lines))[0]) == set(columns)


def test_where_a_pose_is_missing_what_its_imu_lacks_is_named() -> None:
    """As in logs of learned controllers, which hold a gyro and no accelerometer."""
    tables = [("log", [*JOINTS, *(f"gyro_{axis}" for axis in "xyz")])]
    instead = r"\(in place of the pose of 'root': 'sensor/imu_acc/x', 'sensor/imu_acc/y', 'sensor/imu_acc/z'\)"
    with pytest.raises(InputError, match=rf"no column 'qpos/root/x', .* {instead}; columns of the file"):
        check_matched(match_columns(tables, ROBOT, {}, "x"), tables, ROBOT, "x")


def test_units_in_names() -> None:
    assert stated_unit("gyro_x_deg/s") == ("gyro_x", "deg/s")
    assert stated_unit("acc_x_g") == ("acc_x", "g")
    assert stated_unit("mass_g") == ("mass_g", None)
    assert stated_unit("acc_x [m/s²]") == ("acc_x", "m/s^2")
    assert conversion("sensor/imu_acc/x", unit("g"), ROBOT, "x") == 9.80665
    with pytest.raises(InputError, match="needs a unit of acceleration"):
        conversion("sensor/imu_acc/x", unit("rad/s"), ROBOT, "x")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"sensor/imu_gyro/z": None}, "no column 'sensor/imu_gyro/z'; give all columns of a sensor or none"),
        ({"sensor/imu_gyro/w": 0.0}, "'sensor/imu_gyro/w' is no component of the sensor 'imu_gyro'; expected"),
        ({f"sensor/imu_acc/{axis}": None for axis in "xyz"}, "the pose of a free joint cannot be estimated"),
        ({"qvel/root/vx": 0.0}, "give all of a joint's velocities or none"),
        ({f"qvel/root/{p}": 0.0 for p in ("vx", "vy", "vz", "wx", "wy", "wz")}, "but one of its velocity"),
    ],
)
def test_what_is_not_whole_is_refused(log: Columns, change: dict[str, float | None], said: str) -> None:
    columns = log | {name: np.full(len(log["time"]), value) for name, value in change.items() if value is not None}
    columns = {name: own for name, own in columns.items() if name not in POSE and change.get(name, 0.0) is not None}
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        make_recording(columns, mujoco.MjModel.from_xml_string(quadruped()), "walk.csv", "walk")


@pytest.fixture(scope="module")
def log() -> Columns:
    return walk(2.0)


def field_table(log: Columns) -> Columns:
    """The log of a robot without a tracker, in degrees and g, with names of its own."""
    joints = {n: own for n, own in log.items() if not n.startswith(("sensor", "qpos/root"))}
    gyro = {f"gyro_{a} [deg/s]": log[f"sensor/imu_gyro/{a}"] * 180 / np.pi for a in "xyz"}
    return joints | gyro | {f"acc_{a}_g": log[f"sensor/imu_acc/{a}"] / 9.80665 for a in "xyz"}


def test_a_base_with_an_imu_needs_no_pose(log: Columns, tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(quadruped())
    table = field_table(log)
    np.savetxt(
        tmp_path / "walk.csv", np.stack(list(table.values()), 1), delimiter=",", header=",".join(table), comments=""
    )
    data = open_logs(tmp_path / "robot.xml", [tmp_path / "walk.csv"])
    first = data.recordings[0]
    assert not any(base_unmeasured(one) for one in data.recordings)  # its states are estimated
    assert first.seen.all()
    assert not first.sensed[:6].any()
    assert first.sensed[6:].all()
    for sensor in ("imu_gyro", "imu_acc"):
        values = first.measured_by(sensor)
        true = np.stack([log[f"sensor/{sensor}/{axis}"] for axis in "xyz"], 1)
        assert values is not None
        np.testing.assert_allclose(values, true[: len(values)], rtol=1e-6, atol=1e-9)
    assert first.measured_by("imu_quat") is None
    again = save_dataset(tmp_path / "again", data.spec_xml, [first])
    assert "qpos/root/x" not in np.load(again.parent / f"{first.name}.npz")


def test_rows_without_the_imu_are_no_rows_of_a_base_that_only_it_tells(log: Columns) -> None:
    model = mujoco.MjModel.from_xml_string(quadruped())
    gaps = log["sensor/imu_acc/y"].copy()
    gaps[[7, 8]] = np.nan
    holed = log | {"sensor/imu_acc/y": gaps}
    whole = make_recording(holed, model, "walk.csv", "walk")
    alone = make_recording({n: v for n, v in holed.items() if n not in POSE}, model, "walk.csv", "walk")
    assert len(alone.time) == len(whole.time) - 2 == len(log["time"]) - 2
    assert np.isfinite(alone.measured_by("imu_acc")).all()
    assert not base_unmeasured(whole)


def test_arrays_of_a_sensor_are_its_components(log: Columns, tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(quadruped())
    array = np.stack([log[f"sensor/imu_quat/q{part}"] for part in "wxyz"], 1)
    rest = {name: own for name, own in log.items() if not name.startswith("sensor/imu_quat")}
    np.savez(tmp_path / "walk.npz", **{"sensor/imu_quat": array}, **rest)
    first = open_logs(tmp_path / "robot.xml", [tmp_path / "walk.npz"]).recordings[0]
    np.testing.assert_allclose(first.measured_by("imu_quat"), array[: len(first.time)])
