"""[control] of dataset.toml: interpolation and clock of commands, of all recordings or of each."""

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Recording, load, open_logs, save_dataset
from btr_mjx.runs import write_table
from tests.support.convention_logs import ARM, log, sines

LOGS = [log(ARM, sines(np.random.default_rng(0), [0.9, 0.8, 0.8]), i, 2.0) for i in range(2)]
LATE = 0.1
"""By how much commands are stamped late [s]."""
ROWS = 25
"""The same in rows."""


def written(folder: Path, recordings: list[Recording], control: str) -> Path:
    save_dataset(folder, ARM, recordings)
    text = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(text.replace('interpolation = "linear"\n', f"{control}\n"))
    return folder


def late(one: Recording) -> Recording:
    """Each row has the command of `LATE` before."""
    return dataclasses.replace(one, ctrl=one.ctrl[np.maximum(np.arange(len(one.time)) - ROWS, 0)])


def test_a_shift_moves_commands_in_time(tmp_path: Path) -> None:
    data = load(written(tmp_path, [late(one) for one in LOGS], f"shift = {-LATE}"))
    for found, truth in zip(data.recordings, LOGS, strict=True):
        count = len(found.time)
        assert len(truth.time) - ROWS <= count <= len(truth.time) - ROWS + 1
        np.testing.assert_array_equal(found.time, truth.time[:count])
        np.testing.assert_allclose(found.qpos, truth.qpos[:count])
        np.testing.assert_allclose(found.ctrl[: count - 1], truth.ctrl[: count - 1], atol=1e-9)
        np.testing.assert_allclose(found.commands[0][ROWS:], truth.time[:-ROWS], atol=1e-9)
        np.testing.assert_allclose(found.commands[1][ROWS:], truth.ctrl[:-ROWS])


def test_a_shift_may_be_of_one_recording(tmp_path: Path) -> None:
    data = load(written(tmp_path, [LOGS[0], late(LOGS[1])], f"shift = {{ r1 = {-LATE} }}"))
    assert [one.sent is None for one in data.recordings] == [True, False]
    np.testing.assert_allclose(data.recordings[1].ctrl[:-1], LOGS[1].ctrl[: len(data.recordings[1].time) - 1])


def test_a_table_of_commands_with_a_clock_of_its_own_is_shifted_before_it_is_held(tmp_path: Path) -> None:
    (one,) = LOGS[:1]
    names = ("shoulder", "elbow", "wrist")
    (tmp_path / "arm.xml").write_text(ARM)
    write_table(
        tmp_path / "joints.csv", {"t": one.time, **{f"qpos/{n}": x for n, x in zip(names, one.qpos.T, strict=True)}}
    )
    columns = {f"ctrl/{n}": x[::5] for n, x in zip(names, one.ctrl.T, strict=True)}
    write_table(tmp_path / "sent.csv", {"t": one.time[::5] + LATE, **columns})
    write_table(tmp_path / "right.csv", {"t": one.time[::5], **columns})
    text = '[model]\nfile = "arm.xml"\n[[recording]]\nfile = ["joints.csv", "{}.csv"]\n[control]\nshift = {}\n'
    found = []
    for name, shift in (("sent", -LATE), ("right", 0.0)):
        (tmp_path / "dataset.toml").write_text(text.format(name, shift))
        found.append(load(tmp_path))
    for own, right in zip(found[0].recordings, found[1].recordings, strict=True):
        assert own.held_commands
        same = np.isin(np.round(own.time, 6), np.round(right.time, 6))
        assert same.mean() > 0.95
        moved = np.abs(own.ctrl[same] - right.ctrl[np.isin(np.round(right.time, 6), np.round(own.time, 6))])
        assert np.mean(moved > 1e-9) < 0.25  # stamps that are equal up to rounding: a change may be a row late


@pytest.mark.parametrize(
    ("control", "kinds"),
    [
        ('interpolation = "hold"', ["hold", "hold"]),
        ('interpolation = { r0 = "linear", r1 = "hold" }', ["linear", "hold"]),
        ('interpolation = { r1 = "hold" }', ["cubic", "hold"]),
    ],
)
def test_interpolation_is_of_all_recordings_or_of_each(tmp_path: Path, control: str, kinds: list[str]) -> None:
    data = load(written(tmp_path, LOGS, control))
    assert [one.interpolation for one in data.recordings] == kinds


@pytest.mark.parametrize(
    ("control", "message"),
    [
        ('interpolation = "spline"', "'spline'.*expected 'hold'"),
        ('interpolation = { r0 = "steps" }', "'steps'.*expected 'hold'"),
        ('interpolation = { r7 = "hold" }', "no recording 'r7'; expected one of r0, r1"),
        ('shift = "late"', "shift = 'late': expected seconds"),
        ("shift = nan", "expected seconds"),
        ("shift = -100.0", "have a command after a shift of -100 s"),
    ],
)
def test_bad_values_are_refused(tmp_path: Path, control: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load(written(tmp_path, LOGS, control))


def test_what_was_inferred_names_each_recording_where_they_differ(tmp_path: Path) -> None:
    held = LOGS[1].ctrl[np.arange(len(LOGS[1].time)) // 10 * 10]
    written(tmp_path, [LOGS[0], dataclasses.replace(LOGS[1], ctrl=held)], "")
    data = open_logs(tmp_path / "model.xml", [tmp_path / "r0.npz", tmp_path / "r1.npz"])
    assert tomllib.loads(data.inferred)["control"] == {"interpolation": {"r0": "cubic", "r1": "hold"}}
    (tmp_path / "dataset.toml").write_text(data.inferred)
    again = load(tmp_path)
    assert [one.interpolation for one in again.recordings] == ["cubic", "hold"]
