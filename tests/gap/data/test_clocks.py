"""Clocks of their own: values against the motion that was sampled, and holes against rows that were removed."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robot_logs import ARM, FLOATER, simulated_log

from btr_mjx.errors import InputError
from btr_mjx.gap.data import load
from btr_mjx.gap.data.columns.model_columns import state_columns
from btr_mjx.gap.data.recordings.clocks import CLOSE, on_one_clock
from btr_mjx.gap.data.recordings.recording import make_recordings
from btr_mjx.gap.data.recordings.rows import MAX_PARTS, whole_parts
from btr_mjx.gap.data.recordings.splits import split_parts
from btr_mjx.runs import write_table

MODEL, FLOATING = mujoco.MjModel.from_xml_string(ARM), mujoco.MjModel.from_xml_string(FLOATER)
POSITIONS = state_columns(FLOATING)[0]


def test_three_clocks_give_the_motion_that_was_sampled() -> None:
    """Joints at 500, the base at 125 with a dropout and a flipped sign, commands at 50 samples a second."""
    log = simulated_log(FLOATER, 2.0, hold=20)
    joints, base, sent = log.every(2), log.every(8, 3), log.every(20)
    seen = (base.time < 0.8) | (base.time > 1.1)
    signs = np.where(np.arange(seen.sum()) % 7 < 3, -1, 1)
    poses = dict(zip(POSITIONS[:7], base.qpos[seen, :7].T.copy(), strict=True))
    for name in POSITIONS[3:7]:
        poses[name] *= signs
    tables = [
        {"time": joints.time, "qpos/hip": joints.qpos[:, 7]},
        {"time": base.time[seen], **poses},
        {"time": sent.time, "ctrl/hip": sent.ctrl[:, 0]},
    ]
    notes: list[str] = []
    columns, held, _ = on_one_clock(tables, FLOATING, True, "", notes)
    assert held
    np.testing.assert_array_equal(columns["time"], joints.time)
    np.testing.assert_array_equal(columns["qpos/hip"], joints.qpos[:, 7])
    inside = (joints.time >= base.time[0]) & ~((joints.time > 0.795) & (joints.time < 1.11))
    known = np.isfinite(columns["qpos/root/x"])
    assert (known[inside & (joints.time <= base.time[-1])]).all()
    assert not known[(joints.time > 0.81) & (joints.time < 1.09)].any()
    for i, name in enumerate(POSITIONS[:3]):
        np.testing.assert_allclose(columns[name][known], joints.qpos[known, i], atol=2e-5)
    quat = np.stack([columns[name] for name in POSITIONS[3:7]])[:, known]
    alike = np.abs(np.sum(quat * joints.qpos[known, 3:7].T, axis=0))
    np.testing.assert_allclose(alike, 1, atol=3e-5)
    fresh = np.isfinite(columns["ctrl/hip"])
    np.testing.assert_array_equal(columns["ctrl/hip"][fresh], joints.ctrl[fresh, 0])
    parts = make_recordings(tables, FLOATING, "", "flight")
    assert [one.name for one in parts] == ["flight (part 1)", "flight (part 2)"]
    assert parts[0].time[-1] < 0.81 < 1.09 < parts[1].time[0]
    assert any("held on the clock of" in note for note in notes)


def test_clocks_in_the_rows_of_one_table() -> None:
    """A table whose rows are the times of all topics, empty where a topic has no value."""
    log = simulated_log(ARM, 1.0, hold=20)
    joints, sent = log.every(4), log.every(20, 1)
    time = np.concatenate([joints.time, sent.time])
    order, empty = np.argsort(time), np.full((len(sent.time), 2), np.nan)
    qpos = np.concatenate([joints.qpos, empty])[order]
    ctrl = np.concatenate([np.full((len(joints.time), 2), np.nan), sent.ctrl])[order]
    table = {"time": time[order], "qpos/shoulder": qpos[:, 0], "qpos/elbow": qpos[:, 1]}
    table |= {"ctrl/shoulder": ctrl[:, 0], "ctrl/elbow": ctrl[:, 1]}
    (found,) = make_recordings([table], MODEL, "", "walk")
    rows = np.round(1000 * found.time).astype(int)
    assert len(found.time) == len(joints.time) - 1  # no command is known before the first
    np.testing.assert_array_equal(found.qpos, log.qpos[rows])
    np.testing.assert_array_equal(found.ctrl, log.ctrl[rows - (rows % 20 == 0)])
    assert found.held_commands


def test_the_dataset_holds_commands_unless_it_says_otherwise(tmp_path: Path) -> None:
    log = simulated_log(ARM, 1.0)
    joints, sent = log.every(4), log.every(20)
    (tmp_path / "arm.xml").write_text(ARM)
    write_table(tmp_path / "joints.csv", {"t": joints.time, "shoulder": joints.qpos[:, 0], "elbow": joints.qpos[:, 1]})
    write_table(tmp_path / "sent.csv", {"t": sent.time, "u1": sent.ctrl[:, 0], "u2": sent.ctrl[:, 1]})
    text = '[model]\nfile = "arm.xml"\n[[recording]]\nfile = ["joints.csv", "sent.csv"]\n'
    (tmp_path / "dataset.toml").write_text(text)
    data = load(tmp_path)
    assert data.recordings[0].interpolation == "hold"
    (tmp_path / "dataset.toml").write_text(text + '[control]\ninterpolation = "linear"\n')
    smooth = load(tmp_path)
    assert smooth.recordings[0].interpolation == "linear"
    found = np.concatenate([r.ctrl for r in smooth.recordings])
    rows = np.round(1000 * np.concatenate([r.time for r in smooth.recordings])).astype(int)
    np.testing.assert_allclose(found, log.ctrl[rows], atol=2e-3)


def test_numbers_that_cannot_be_interpolated_are_refused() -> None:
    time, huge = np.arange(40.0), np.full(20, 1e308)
    huge[::2] *= -1
    tables = [{"time": time, "qpos/shoulder": time, "qpos/elbow": time}, {"time": 2 * time[:20], "qvel/elbow": huge}]
    with pytest.raises(
        InputError, match="'qvel/elbow' cannot be interpolated on the clock of qpos/shoulder, qpos/elbow"
    ):
        on_one_clock(tables, MODEL, True, "log.csv", [])


def test_clocks_without_common_times_are_refused() -> None:
    log = simulated_log(ARM, 1.0)
    tables = [
        {"time": log.time, "qpos/shoulder": log.qpos[:, 0], "qpos/elbow": log.qpos[:, 1]},
        {"time": log.time + 1e6, "ctrl/shoulder": log.ctrl[:, 0], "ctrl/elbow": log.ctrl[:, 1]},
    ]
    with pytest.raises(InputError, match=r"ctrl/shoulder.* from 1e\+06 to .*give both times of one clock"):
        make_recordings(tables, MODEL, "log", "walk")


@given(missing=st.sets(st.integers(0, 119)), gaps=st.dictionaries(st.integers(1, 118), st.floats(0.0, 0.2), max_size=4))
def test_parts_have_no_holes_and_lose_only_short_ones(missing: set[int], gaps: dict[int, float]) -> None:
    """The slow route: walk over the rows and begin a new part at every hole."""
    step = np.full(120, 0.01)
    for row, more in gaps.items():
        step[row] += more
    time, rows = np.cumsum(step), np.array(sorted(set(range(120)) - missing))
    if len(rows) < 2:
        return
    own = time[rows]
    usual = float(np.percentile(np.diff(own), 90))
    expected: list[list[int]] = [[0]]
    for k in range(1, len(rows)):
        hole = rows[k] - rows[k - 1] > 3 or own[k] - own[k - 1] > CLOSE * usual
        expected.append([k]) if hole else expected[-1].append(k)
    notes: list[str] = []
    found = whole_parts(rows, own, 5, notes)
    kept = [part for part in expected if len(part) >= 5] if len(expected) > 1 else expected
    assert [[*range(part.start, part.stop)] for part in found] == sorted(
        sorted(kept, key=len, reverse=True)[:MAX_PARTS], key=lambda part: part[0]
    )
    assert bool(notes) == (len(expected) > 1)


def test_the_last_third_of_parts_is_held_out() -> None:
    log = simulated_log(ARM, 3.0)
    columns = {"time": log.time, "qpos/shoulder": log.qpos[:, 0], "qpos/elbow": log.qpos[:, 1]}
    columns |= {"ctrl/shoulder": log.ctrl[:, 0], "ctrl/elbow": log.ctrl[:, 1]}
    columns = {name: values.copy() for name, values in columns.items()}
    columns["qpos/elbow"][2700:2750] = np.nan
    parts = split_parts(make_recordings([columns], MODEL, "", "walk"), "")
    held = sum(len(one.time) for one in parts if one.split == "test")
    assert held == pytest.approx(2950 / 3, abs=2)
    assert [one.split for one in parts] == ["fit", "test", "test"]
    assert all((np.diff(one.time) < 0.002).all() for one in parts)
