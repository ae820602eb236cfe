"""Long recordings: stretches against rows of the whole table, checks of every row, bounded numbers of samples."""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import polars as pl
import pytest
from gap_recordings import MODEL, XML, smooth_recording
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.errors import InputError
from btr_mjx.gap.data import DatasetDescription, Format, load, read_columns, save_dataset
from btr_mjx.gap.data.columns.model_columns import ungroup_columns
from btr_mjx.gap.data.files import frames, text
from btr_mjx.gap.data.recordings import stretches as long
from btr_mjx.gap.data.recordings.recording import make_recordings
from btr_mjx.gap.data.recordings.stretches import Share, read_stretches, shares, stretch_rows
from btr_mjx.gap.preflight import preflight

COUNT = 2000
SUFFIXES: tuple[Format, ...] = ("csv", "parquet", "npz")


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is long here is short elsewhere."""
    monkeypatch.setattr(long, "MAX_SAMPLES", 1000)
    monkeypatch.setattr(long, "KEPT_SAMPLES", 600)
    monkeypatch.setattr(long, "MAX_STRETCHES", 6)
    monkeypatch.setattr(long, "STRETCH_SECONDS", 0.25)
    monkeypatch.setattr(long, "STRETCH_SAMPLES", 30)
    monkeypatch.setattr(text, "BLOCK_BYTES", 10_000)
    monkeypatch.setattr(frames, "BLOCK_NUMBERS", 3_000)


def dataset(folder: Path, file_format: Format = "csv", names: tuple[str, ...] = ("walk",), count: int = COUNT) -> Path:
    """A dataset without splits, of recordings with 5 ms between samples."""
    rng = np.random.default_rng(0)
    recordings = [smooth_recording(name, rng, count=count) for name in names]
    table = save_dataset(folder, XML, recordings, file_format=file_format)
    table.write_text(table.read_text().replace('split = "fit"\n', ""))
    return folder


def edit(file: Path, row: int, column: str, value: str) -> None:
    """Replace a field of a CSV file; row 0 is the first after the header."""
    lines = [line.split(",") for line in file.read_text().splitlines()]
    lines[row + 1][lines[0].index(column)] = value
    file.write_text("\n".join(map(",".join, lines)) + "\n")


@pytest.mark.parametrize("file_format", SUFFIXES)
def test_stretches_are_rows_of_the_table(tmp_path: Path, file_format: Format) -> None:
    """Blocks of any size leave no trace: every value is that of the whole table, bit for bit."""
    file = dataset(tmp_path, file_format) / f"walk.{file_format}"
    whole = ungroup_columns(read_columns(file), MODEL, "")
    notes: list[str] = []
    done: list[int] = []
    found, _ = read_stretches([file], Share(COUNT, 600), MODEL, notes, done.append)
    expected = stretch_rows(Share(COUNT, 600), float(np.median(np.diff(whole["time"][:50]))))
    assert len(found) == len(expected) == 6
    for stretch, rows in zip(found, expected, strict=True):
        assert set(stretch) == set(whole)
        for name, values in stretch.items():
            np.testing.assert_array_equal(values, whole[name][rows.start : rows.stop])
    assert "600 of 2000 samples (30.0%) are used, in 6 stretches" in notes[0]
    assert len(notes) == 1
    assert 0.9 * file.stat().st_size < sum(done) <= file.stat().st_size


@given(
    rows=st.integers(1001, 10**7),
    kept=st.integers(1, 1000),
    interval=st.floats(1e-5, 10),
    from_start=st.booleans(),
)
def test_stretches_are_apart_and_bounded(rows: int, kept: int, interval: float, from_start: bool) -> None:
    found = stretch_rows(Share(rows, kept), interval, from_start)
    ends = [end for one in found for end in (one.start, one.stop)]
    assert ends == sorted(ends)
    assert ends[0] >= 0
    assert ends[-1] <= rows
    assert len({len(one) for one in found}) == 1
    shortest = max(long.STRETCH_SECONDS / interval, long.STRETCH_SAMPLES)
    assert len(found[0]) >= min(int(shortest), rows, long.MAX_SAMPLES)
    samples = sum(map(len, found))
    assert samples <= max(kept, min(long.MAX_SAMPLES, shortest + 1))
    if not from_start and kept > 2 * shortest:
        assert len(found) > 1


def test_short_datasets_are_used_whole() -> None:
    assert shares([300, 0, 700]) == [None, None, None]
    assert shares([600, 0, 1800]) == [Share(600, 150), Share(0, 1), Share(1800, 450)]


def test_the_last_third_of_the_time_is_held_out(tmp_path: Path) -> None:
    data = load(dataset(tmp_path))
    assert [r.split for r in data.recordings] == ["fit"] * 4 + ["test"] * 2
    times = np.concatenate([r.time for r in data.recordings])
    assert (np.diff(times) > 0).all()
    assert len(times) == 600
    assert data.recordings[2].name == f"walk at {data.recordings[2].time[0]:.6g} s"
    lines = [f.message for f in preflight(data) if f.topic == "loading"]
    assert any("600 of 2000 samples" in line for line in lines)


def test_stretches_of_a_recording_are_on_one_side(tmp_path: Path) -> None:
    data = load(dataset(tmp_path, "parquet", ("a", "b", "c"), 800))
    assert {(r.name[0], r.split) for r in data.recordings} == {("a", "fit"), ("b", "fit"), ("c", "test")}
    assert len(data.recordings) in range(9, 13)  # of 200 samples each, in stretches of about 50


def test_progress_counts_the_bytes_of_all_files(tmp_path: Path) -> None:
    folder = dataset(tmp_path, "csv", ("a", "b"), 800)
    calls: list[tuple[int, int]] = []
    load(folder, lambda done, total: calls.append((done, total)))
    total = sum((folder / f"{name}.csv").stat().st_size for name in "ab")
    assert calls[0] == (0, total)
    assert len(calls) > 20
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)
    assert 0.99 * total < calls[-1][0] <= total


@pytest.mark.parametrize(
    ("rows", "column", "value", "message"),
    [
        ([1995], "qpos/hip", "high", r"'qpos/hip' holds 'high' in row 1996 of the data"),
        ([1000], "time", "0.5", r"time goes back from .* to 0\.5 s in row 1001; "),
    ],
)
def test_every_row_is_checked(tmp_path: Path, rows: list[int], column: str, value: str, message: str) -> None:
    """In rows that are not kept, and wherever blocks meet; messages name the row of the file."""
    folder = dataset(tmp_path)
    for row in rows:
        edit(folder / "walk.csv", row, column, value)
    with pytest.raises(InputError, match=message):
        load(folder)


@pytest.mark.parametrize("file_format", ["csv", "parquet"])
@pytest.mark.parametrize("length", [2, 3])
def test_missing_values_at_any_place(tmp_path: Path, file_format: Format, length: int) -> None:
    """Wherever they are beside the ends of blocks, two missing rows are dropped and three split a stretch."""
    file = dataset(tmp_path) / "walk.csv"
    table = pl.read_csv(file)
    for row in range(0, 300, 13 if length == 2 else 60):
        values = table["qpos/hip"].to_numpy().copy()
        values[row : row + length] = np.nan
        changed = table.with_columns(pl.Series("qpos/hip", values))
        target = tmp_path / f"changed.{file_format}"
        changed.write_csv(target, null_value="") if file_format == "csv" else changed.write_parquet(target)
        notes: list[str] = []
        stretches, _ = read_stretches([target], Share(COUNT, 600), MODEL, notes, lambda count: None)
        assert f"{target.name}: {length} of all rows have missing values" in notes
        lost = [int(np.isnan(columns["qpos/hip"]).sum()) for columns in stretches]
        parts = [make_recordings([columns], MODEL, "", "walk") for columns in stretches]
        for count, found in zip(lost, parts, strict=True):
            longest = max(np.diff(one.time).max() for one in found)
            assert longest < (0.019 if count == 2 else 0.0061)  # intervals are 4 to 6 ms
            assert (count == 3) == any("parts at" in note for one in found for note in one.notes)


def test_gaps_outside_the_stretches_are_reported(tmp_path: Path) -> None:
    file = dataset(tmp_path) / "walk.csv"
    table = pl.read_csv(file)
    late = table.with_columns(time=pl.col("time") + 7.0 * (pl.int_range(pl.len()) > 3))
    late.write_csv(file)
    assert any("1 gaps of more than three intervals in all rows, the longest of 7.0" in n for n in load(tmp_path).notes)


def test_activations_need_the_start(tmp_path: Path) -> None:
    """The activation of an actuator is integrated from the start of a recording: one stretch, from there on."""
    xml = XML.replace("<position ", '<position timeconst="0.1" ')
    assert mujoco.MjModel.from_xml_string(xml).na == 1
    recording = smooth_recording("walk", np.random.default_rng(0), count=COUNT)
    save_dataset(tmp_path, xml, [recording, dataclasses.replace(recording, name="b", split="test")])
    data = load(tmp_path)
    assert [len(r.time) for r in data.recordings] == [300, 300]
    np.testing.assert_array_equal(data.recordings[0].time, recording.time[:300])
    assert "from the beginning on" in data.notes[0]


def test_damaged_and_foreign_columns_are_refused_before_all_is_read(tmp_path: Path) -> None:
    file = dataset(tmp_path) / "walk.csv"
    content = file.read_text()
    file.write_text(content.replace("qpos/hip", "qpos/hop", 1))
    done: list[int] = []
    with pytest.raises(InputError, match="'qpos/hop' names no joint"):
        load(tmp_path, lambda count, total: done.append(count))
    assert done[-1] <= text.BLOCK_BYTES
    cut = tmp_path / "walk.parquet"
    pl.read_csv(content.encode()).write_parquet(cut)
    cut.write_bytes(cut.read_bytes()[:-20])
    with pytest.raises(InputError, match="not a readable parquet table"):
        read_stretches([cut], Share(COUNT, 600), MODEL, [], lambda count: None)


def test_description_survives(tmp_path: Path) -> None:
    """Overrides of a recording hold for its stretches."""
    recording = smooth_recording("walk", np.random.default_rng(0), count=COUNT)
    other = dataclasses.replace(recording, name="other", split="test")
    save_dataset(tmp_path, XML, [recording, other], DatasetDescription(overrides={"other": {"body:thigh/mass": 0.7}}))
    data = load(tmp_path)
    assert {(r.split, float(r.model.body("thigh").mass[0])) for r in data.recordings} == {("fit", 0.5), ("test", 0.7)}
