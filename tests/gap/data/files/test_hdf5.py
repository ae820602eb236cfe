"""HDF5 files, written by h5py, against the motion that was written."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from robot_logs import ARM, simulated_log

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data import Dataset, open_logs

LOG = simulated_log(ARM, 1.5, hold=20)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path


def opened(folder: Path) -> tuple[Dataset, np.ndarray, np.ndarray]:
    """The dataset, and its qpos and the rows of the log that these are."""
    data = open_logs(folder / "arm.xml", [folder / "log.h5"])
    time = np.concatenate([one.time for one in data.recordings])
    return data, np.concatenate([one.qpos for one in data.recordings]), np.round(1000 * time).astype(int)


def test_groups_with_clocks_of_their_own(folder: Path) -> None:
    joints, sent = LOG.every(4), LOG.every(20)
    with h5py.File(folder / "log.h5", "w") as file:
        file["joint_states/time"] = joints.time + 1.7e9
        file["joint_states/position"] = np.degrees(joints.qpos[:, ::-1])
        file["joint_states/position"].attrs["units"] = "deg"
        file["joint_states/joint_names"] = np.array(["elbow", "shoulder"], dtype="S8")
        file["commands/timestamp"] = sent.time + 1.7e9
        file["commands/data"] = sent.ctrl
        file["video/frames"] = np.zeros((3, 4, 4))
    data, qpos, rows = opened(folder)
    np.testing.assert_allclose(qpos, LOG.qpos[rows], atol=1e-9)
    np.testing.assert_array_equal(np.concatenate([one.ctrl for one in data.recordings]), LOG.ctrl[rows])
    assert any("joint_states/position/elbow from deg" in note for note in data.recordings[0].notes)


def test_arrays_under_mujocos_names_and_compound_tables(folder: Path) -> None:
    with h5py.File(folder / "log.h5", "w") as file:
        file["time"], file["qpos"], file["ctrl"] = LOG.time, LOG.qpos, LOG.ctrl
    _, qpos, rows = opened(folder)
    np.testing.assert_array_equal(qpos, LOG.qpos[rows])
    kind = [("time", "f8"), ("shoulder", "f8"), ("elbow", "f8"), ("u1", "f8"), ("u2", "f8"), ("mode", "S4")]
    table = np.zeros(len(LOG.time), kind)
    for name, values in zip(table.dtype.names[:5], [LOG.time, *LOG.qpos.T, *LOG.ctrl.T], strict=True):
        table[name] = values
    with h5py.File(folder / "log.h5", "w") as file:
        file["table"] = table
    _, qpos, rows = opened(folder)
    np.testing.assert_array_equal(qpos, LOG.qpos[rows])


def test_what_cannot_be_read_is_one_line(folder: Path) -> None:
    (folder / "log.h5").write_bytes(b"no HDF5 at all" * 100)
    with pytest.raises(DamagedFile, match="not a readable HDF5 file"):
        opened(folder)
    with h5py.File(folder / "log.h5", "w") as file:
        file["position"] = LOG.qpos
    with pytest.raises(InputError, match=r"no dataset is called time.*'position'"):
        opened(folder)
    with h5py.File(folder / "log.h5", "w") as file:
        file["time"] = LOG.time
        file.create_dataset("qpos", shape=(1 << 28, 3), dtype="f8", compression="gzip")
    with pytest.raises(InputError, match="its numbers take 6 GiB"):
        opened(folder)


def test_a_time_in_degrees_is_refused(folder: Path) -> None:
    with h5py.File(folder / "log.h5", "w") as file:
        file["time"] = 0.01 * np.arange(50)
        file["time"].attrs["units"] = "deg"
        file["qpos"], file["ctrl"] = np.zeros((50, 2)), np.zeros((50, 2))
    with pytest.raises(InputError, match="column 'time': is in deg, 'time' needs a unit of time"):
        opened(folder)


def test_data_outside_the_file_are_not_read(folder: Path) -> None:
    (folder / "secret.bin").write_bytes(bytes(8 * 1500))
    with h5py.File(folder / "log.h5", "w") as file:
        file["time"] = LOG.time
        file.create_dataset("q", shape=(1500,), dtype="f8", external=[(str(folder / "secret.bin"), 0, 8 * 1500)])
    with pytest.raises(InputError, match="'q' is stored in another file"):
        opened(folder)
