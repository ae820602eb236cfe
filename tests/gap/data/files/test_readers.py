"""Formats of installed packages, offered as entry points."""

import json
from pathlib import Path

import numpy as np
import pytest
from installed_packages import install
from robot_logs import ARM, simulated_log

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data import open_dataset, read_columns
from btr_mjx.runs import write_table

LOG = simulated_log(ARM, 1.0)


CODE = """
import json

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Reader, log_table

def read(path):
    try:
        channels = json.loads(path.read_text())
    except ValueError as error:
        raise InputError(f"{path}: no log ({error})") from None
    arrays = {name: np.array(values) for name, values in channels.items()}
    return [log_table(path, path.stem, arrays, units=dict.fromkeys(("pos shoulder", "pos elbow"), "deg"))]

robo = Reader((".robo",), read)
none = 3
"""


def folder_with(path: Path, text: str) -> Path:
    (path / "arm.xml").write_text(ARM)
    (path / "run.robo").write_text(text)
    return path


def channels() -> str:
    columns = {"t": LOG.time, "pos shoulder": np.degrees(LOG.qpos[:, 0]), "pos elbow": np.degrees(LOG.qpos[:, 1])}
    columns |= {"cmd shoulder": LOG.ctrl[:, 0], "cmd elbow": LOG.ctrl[:, 1]}
    return json.dumps({name: values.tolist() for name, values in columns.items()})


def test_a_reader_of_another_package_reads_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = folder_with(tmp_path, channels())
    with pytest.raises(InputError, match="0 logs"):
        open_dataset(folder)
    install(tmp_path / "site", monkeypatch, "robo_logs", CODE, "btr_mjx.readers", "robo = robo_logs:robo")
    data = open_dataset(folder)
    np.testing.assert_allclose(np.concatenate([one.qpos for one in data.recordings]), LOG.qpos, atol=1e-12)
    np.testing.assert_array_equal(np.concatenate([one.ctrl for one in data.recordings]), LOG.ctrl)
    (folder / "run.robo").write_text("{")
    with pytest.raises(InputError, match=r"run\.robo: no log"):
        open_dataset(folder)


@pytest.mark.parametrize(("name", "message"), [("none", "got int, expected a Reader"), ("absent", "AttributeError")])
def test_what_is_no_reader_is_refused_with_its_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, message: str
) -> None:
    install(tmp_path / "site", monkeypatch, f"robo_{name}", CODE, "btr_mjx.readers", f"robo = robo_{name}:{name}")
    with pytest.raises(InputError, match=f"entry point robo = 'robo_{name}:{name}' of robo_{name}: {message}"):
        open_dataset(folder_with(tmp_path, channels()))


def test_columns_of_width_one_and_groups_in_npz(tmp_path: Path) -> None:
    arrays = {
        "time": LOG.time[:, None],
        "qpos": LOG.qpos,
        "sensor/a": LOG.ctrl[:, :1],
        "sensor/b": LOG.ctrl,
        "q": LOG.qpos,
    }
    np.savez(tmp_path / "log.npz", **arrays)
    found = read_columns(tmp_path / "log.npz")
    assert list(found) == ["time", "qpos", "sensor/a", "sensor/b/0", "sensor/b/1", "q/0", "q/1"]
    np.testing.assert_array_equal(found["time"], LOG.time)
    np.testing.assert_array_equal(found["qpos"], LOG.qpos)


def test_tables_under_mujocos_names(tmp_path: Path) -> None:
    columns = {"time": LOG.time, "qpos/elbow": LOG.qpos[:, 1]}
    for suffix in ("csv", "parquet"):
        write_table(tmp_path / f"log.{suffix}", columns)
        found = read_columns(tmp_path / f"log.{suffix}")
        assert list(found) == list(columns)
        np.testing.assert_array_equal(found["qpos/elbow"], columns["qpos/elbow"])
    with pytest.raises(InputError, match=r"a recording is a \.csv, .* file, got '\.json'"):
        read_columns(tmp_path / "log.json")
    (tmp_path / "log.npz").write_bytes(b"")
    with pytest.raises(DamagedFile, match="is empty"):
        read_columns(tmp_path / "log.npz")


def test_files_that_only_together_have_all_columns_are_one_recording(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    states = {"time": LOG.time, "q_shoulder": LOG.qpos[:, 0], "q_elbow": LOG.qpos[:, 1]}
    sent = LOG.every(20)
    commands = {"time": sent.time, "u_shoulder": sent.ctrl[:, 0], "u_elbow": sent.ctrl[:, 1]}
    write_table(tmp_path / "states.csv", states)
    write_table(tmp_path / "commands.csv", commands)
    data = open_dataset(tmp_path)
    np.testing.assert_array_equal(np.concatenate([one.qpos for one in data.recordings]), LOG.qpos)
    assert len(data.recordings) == 2  # the first part of the recording and its last third
    assert [one for one in data.notes if '"commands.csv", "states.csv" are read as one recording' in one]
    (tmp_path / "again").mkdir()
    for name in ("arm.xml", "states.csv", "commands.csv"):
        (tmp_path / name).rename(tmp_path / "again" / name)
    (tmp_path / "again/dataset.toml").write_text(data.inferred)
    again = open_dataset(tmp_path / "again")
    for one, other in zip(data.recordings, again.recordings, strict=True):
        np.testing.assert_array_equal(one.commands[1], other.commands[1])


def test_a_log_without_commands_beside_a_whole_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    states = {"time": LOG.time, "q_shoulder": LOG.qpos[:, 0], "q_elbow": LOG.qpos[:, 1]}
    write_table(tmp_path / "run1.csv", states | {"u_shoulder": LOG.ctrl[:, 0], "u_elbow": LOG.ctrl[:, 1]})
    for columns in (states, {"time": LOG.time, "volts": LOG.time}):
        write_table(tmp_path / "run2.csv", columns)
        with pytest.raises(InputError, match=r"run2\.csv: there is no column .*'ctrl/shoulder', 'ctrl/elbow'"):
            open_dataset(tmp_path)
