"""Recordings with an inertial unit: without a pose of the base, and beside one."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from imu_logs import POSE, quadruped, walk
from scipy.spatial.transform import Rotation

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Recording, make_recording, open_dataset, with_imu
from btr_mjx.runs import write_arrays

MODEL = mujoco.MjModel.from_xml_string(quadruped())
NOISE = np.array([5e-4, 5e-4, 5e-4, 1e-3, 1e-3, 1e-3])
"""Of the pose in `walk` [m], [rad]."""


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    return walk(seconds=2.0, seed=4, mount=Rotation.from_rotvec([0.02, -0.015, 0.01]))


def errors(one: Recording, columns: dict[str, np.ndarray]) -> np.ndarray:
    """(K, 6) distances of the base from what was measured, in place and orientation."""
    pose = np.stack([columns[name] for name in POSE], 1)
    true, found = (Rotation.from_quat(q[:, 3:7], scalar_first=True) for q in (pose, one.qpos))
    return np.concatenate([one.qpos[:, :3] - pose[:, :3], (true.inv() * found).as_rotvec()], axis=1)


def written(folder, columns, xml):
    (folder / "robot.xml").write_text(xml)
    write_arrays(folder / "walk.npz", {name: values for name, values in columns.items() if name not in POSE})
    return folder


def test_log_without_a_pose_has_the_motion_of_its_base(columns, tmp_path):
    data = open_dataset(written(tmp_path, columns, quadruped()))
    assert any("the IMU is turned by" in note for note in data.notes)
    ends = np.searchsorted(columns["time"], [r.time[0] for r in data.recordings])
    for one, first in zip(data.recordings, ends, strict=True):
        own = {name: values[first : first + len(one.time)] for name, values in columns.items()}
        off = errors(one, own)
        assert one.seen.all()
        assert one.estimate is not None
        assert np.abs(off[:, 2]).mean() < 6e-3
        assert np.abs(off[:, 3:5]).mean() < np.radians(1.5)
        slope = np.gradient(off[:, :3], one.time, axis=0)  # of positions that were measured with noise
        assert np.abs(slope.mean(0)).max() < 0.05


def test_robot_that_touches_nothing_needs_its_pose(columns, tmp_path):
    xml = quadruped()
    floor = next(line for line in xml.splitlines() if 'name="floor"' in line)
    with pytest.raises(InputError, match="the pose of 'trunk' was not measured, and the robot can touch nothing"):
        open_dataset(written(tmp_path, columns, xml.replace(floor, "")))


def posed(columns: dict[str, np.ndarray]) -> Recording:
    return make_recording(columns, MODEL, "walk.csv", "walk")


def test_unit_beside_a_pose_sharpens_it(columns):
    rng, noisy = np.random.default_rng(0), dict(columns)
    for name in POSE[:3]:
        noisy[name] = columns[name] + 3e-3 * rng.standard_normal(len(columns["time"]))
    (sharp,) = with_imu([posed(noisy)])
    raw, off = (errors(one, columns)[:, :3].std(0) for one in (posed(noisy), sharp))
    assert sharp.estimate is not None
    assert (off < 0.5 * raw).all()


@pytest.mark.parametrize("fault", ["units", "pose"])
def test_unit_that_contradicts_the_pose_is_not_used(columns, fault):
    bad = dict(columns)
    for axis in "xyz":
        if fault == "units":
            bad[f"sensor/imu_acc/{axis}"] = columns[f"sensor/imu_acc/{axis}"] / 9.81
        else:
            bad[f"sensor/imu_gyro/{axis}"] = -columns[f"sensor/imu_gyro/{axis}"]
    before = posed(bad)
    assert with_imu([before])[0] is before


def test_recordings_without_a_unit_stay_as_they_are(columns):
    plain = posed({name: values for name, values in columns.items() if not name.startswith("sensor/")})
    estimated = replace(posed(columns), estimate=with_imu([posed(columns)])[0].estimate)
    assert with_imu([plain])[0] is plain
    assert with_imu([estimated])[0] is estimated
