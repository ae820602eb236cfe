"""IMUs of a quadruped that was simulated, with the faults that logs and mounts have."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from imu_logs import POSE, dataset, quadruped, walk
from scipy.spatial.transform import Rotation

from btr_mjx.gap.data.recordings.recording import StateEstimate
from btr_mjx.gap.preflight import Finding, preflight
from btr_mjx.gap.preflight.imu import imu_conventions

Columns = dict[str, np.ndarray]
GYRO, ACCELEROMETER = ([f"sensor/imu_{name}/{axis}" for axis in "xyz"] for name in ("gyro", "acc"))
ORIENTATION = [f"sensor/imu_quat/q{axis}" for axis in "wxyz"]


@pytest.fixture(scope="module")
def right() -> Columns:
    """A log without a fault, whose IMU is mounted 2 degrees off."""
    return walk(mount=Rotation.from_rotvec(np.deg2rad(2) * np.array([0.6, 0.0, 0.8])))


def times(columns: Columns, names: list[str], factor: float) -> Columns:
    return columns | {name: factor * columns[name] for name in names}


def without_gravity(columns: Columns) -> Columns:
    turns = Rotation.from_quat(np.stack([columns[name] for name in ORIENTATION], 1), scalar_first=True)
    weight = turns.inv().apply([0.0, 0.0, 9.81])
    return columns | {name: columns[name] - own for name, own in zip(ACCELEROMETER, weight.T, strict=True)}


def found(columns: Columns, seen: str) -> list[Finding]:
    """Findings where the pose, the sensor of the orientation or neither was logged."""
    hidden = {"pose": ORIENTATION, "sensor": POSE, "neither": [*POSE, *ORIENTATION]}[seen]
    findings = imu_conventions(dataset({name: own for name, own in columns.items() if name not in hidden}))
    assert {one.level for one in findings} <= {"warning" if seen == "pose" else "error"}
    return findings


@pytest.mark.parametrize("seen", ["pose", "sensor", "neither"])
def test_noise_biases_and_a_mount_that_is_nearly_right_are_no_faults(right: Columns, seen: str) -> None:
    assert found(right, seen) == []


FAULTS: list[tuple[str, list[str], Callable[[Columns], Columns], str]] = [
    ("gyro in degrees", GYRO, lambda c: times(c, GYRO, 180 / np.pi), "is in deg/s"),
    ("gyro in millirad/s", GYRO, lambda c: times(c, GYRO, 1e3), "is in another unit"),
    ("gyro negated", GYRO, lambda c: times(c, GYRO, -1.0), "opposite sign"),
    ("accelerometer in g", ACCELEROMETER, lambda c: times(c, ACCELEROMETER, 1 / 9.80665), "is in g"),
    ("accelerometer in mg", ACCELEROMETER, lambda c: times(c, ACCELEROMETER, 1e3 / 9.80665), "is in another unit"),
    ("accelerometer negated", ACCELEROMETER, lambda c: times(c, ACCELEROMETER, -1.0), "opposite sign"),
    ("without gravity", ACCELEROMETER, without_gravity, "gravity was taken out"),
]


@pytest.mark.parametrize("seen", ["pose", "sensor", "neither"])
@pytest.mark.parametrize(("names", "change", "said"), [own[1:] for own in FAULTS], ids=[own[0] for own in FAULTS])
def test_units_and_signs_are_told(
    right: Columns, names: list[str], change: Callable[[Columns], Columns], said: str, seen: str
) -> None:
    if seen == "neither" and names is GYRO:
        if said == "opposite sign":
            assert found(change(right), seen) == []  # nothing tells it
            return
        said = "gyros measure up to"
    (one,) = found(change(right), seen)
    assert said in one.message
    assert one.message.startswith(", ".join(names))


def test_a_unit_has_lines_to_write(right: Columns) -> None:
    (one,) = found(times(right, GYRO, 180 / np.pi), "pose")
    assert [line for line in one.lines if "deg/s" in line] == [f'"{name}" = "deg/s"' for name in GYRO]


@pytest.mark.parametrize("angles", [(0, 0, 90), (180, 0, 0), (0, 0, 180), (90, 0, 90), (15, 0, 0), (0, 0, -14)])
def test_turned_axes_are_told_with_the_quaternion_that_mends_them(angles: tuple[float, float, float]) -> None:
    true = Rotation.from_euler("XYZ", angles, degrees=True)
    columns = walk(mount=true)
    (one,) = found(columns, "pose")
    assert one.evidence["degrees"] == pytest.approx(np.rad2deg(true.magnitude()), abs=2)
    quat = re.search(r'quat="([^"]*)"', one.message)
    assert quat is not None
    mended = dataset({n: v for n, v in columns.items() if n not in ORIENTATION}, quadruped(quat=quat[1]))
    assert imu_conventions(mended) == []
    assert found(columns, "sensor") == []  # the orientation of the same IMU turns with it


def test_two_faults_are_both_told(right: Columns) -> None:
    columns = times(times(right, GYRO, -180 / np.pi), ACCELEROMETER, 1 / 9.80665)
    said = " ".join(one.message for one in found(columns, "pose"))
    assert all(text in said for text in ("is in deg/s", "opposite sign", "is in g"))


def test_of_a_robot_that_stands_still_the_accelerometer_is_checked() -> None:
    still = walk(reach=0.0)
    assert found(still, "pose") == []
    assert found(times(still, GYRO, -1.0), "pose") == []  # nothing tells it
    (one,) = found(times(still, ACCELEROMETER, -1.0), "pose")
    assert "opposite sign" in one.message


def test_a_pose_that_was_estimated_is_no_measurement(right: Columns) -> None:
    """The estimate of a base comes from the IMU itself, and would agree with it."""
    data = dataset(times({n: v for n, v in right.items() if n not in ORIENTATION}, ACCELEROMETER, -1.0))
    (one,) = data.recordings
    sigma = np.r_[np.full(6, 1e-3), np.full(one.model.nv - 6, np.nan)]
    estimated = replace(one, estimate=StateEstimate(np.tile(sigma, 2), np.tile(sigma, 2)))
    (finding,) = imu_conventions(replace(data, recordings=(estimated,)))
    assert finding.level == "error"
    assert "of the model at its start" in finding.message


def test_an_imu_in_place_of_a_pose_is_judged_before_the_joints(right: Columns) -> None:
    """All predictions start from the pose that it tells."""
    joints = [name for name in right if name.startswith(("qpos/", "ctrl/")) and name not in POSE]
    columns = times(without_gravity(right), joints, 180 / np.pi)
    data = dataset({name: own for name, own in columns.items() if name not in [*POSE, *ORIENTATION]})
    (error,) = [one.message for one in preflight(data) if one.level == "error"]
    assert "gravity was taken out" in error
