"""Text tables in any dialect against the numbers that were written."""

from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robot_logs import ARM, simulated_log

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data import open_dataset, open_logs
from btr_mjx.gap.data.files import text
from btr_mjx.gap.data.files.text import parse_rows, read_dialect, read_text_table
from btr_mjx.gap.data.recordings.stretches import Share, read_stretches

NUMBERS = np.round(np.random.default_rng(0).normal(size=(40, 3)), 4)


def written(values: np.ndarray, separator: str, comma: bool, names: str, end: str = "\n") -> bytes:
    rows = [separator.join(f"{v:.4f}".replace(".", "," if comma else ".") for v in row) for row in values]
    return end.join([names, *rows, ""]).encode()


BEFORE = ("", "# run 7\n# on: 3;4\n")
DIALECTS = product((",", ";", "\t", " ", "   "), (False, True), ("\n", "\r\n"), ("", "# "), BEFORE)


@pytest.mark.parametrize(
    ("separator", "comma", "end", "mark", "before"), [case for case in DIALECTS if case[:2] != (",", True)]
)
def test_every_dialect_gives_the_same_numbers(
    tmp_path: Path, separator: str, comma: bool, end: str, mark: str, before: str
) -> None:
    file = tmp_path / "log.txt"
    names = mark + separator.join(["t", "q1", "q2"])
    file.write_bytes(before.replace("\n", end).encode() + written(NUMBERS, separator, comma, names, end))
    (table,) = read_text_table(file)
    assert list(table.columns) == ["t", "q1", "q2"]
    np.testing.assert_array_equal(np.stack([*table.columns.values()], axis=1), NUMBERS)


def test_marks_quotes_units_and_separators_at_the_end(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    rows = "".join(f"{k};{k},5;text;;\r\n" for k in range(30))
    file.write_bytes(("\ufeff" + '"time";"q, hip";mode;empty;\r\n[ms];[deg];-;;\r\n' + rows).encode())
    (table,) = read_text_table(file)
    assert list(table.columns) == ["time", "q, hip", "mode", "empty"]
    assert table.units == {"time": "ms", "q, hip": "deg"}
    assert list(table.text) == ["mode"]
    np.testing.assert_array_equal(table.columns["q, hip"], np.arange(30) + 0.5)


def test_latin_degree_signs_are_read(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_bytes("time;Winkel [°]\n".encode("cp1252") + b"".join(b"%d;1,5\n" % k for k in range(9)))
    assert read_dialect(file).names == ("time", "Winkel [°]")


def test_a_file_without_names_has_numbers_for_names(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("".join(f"{k},{k + 1}\n" for k in range(5)))
    assert read_dialect(file).names == ("1", "2")


@pytest.mark.parametrize(
    ("content", "kind", "message"),
    [
        (b"", DamagedFile, "is empty"),
        (b"dear diary\ntoday nothing moved\n", DamagedFile, "holds no table.*'dear diary'"),
        ("t,q\n1,2\n".encode("utf-16"), DamagedFile, "UTF-16"),
        (b"t,q\n", InputError, "no rows"),
        (b"t,q,q\n1,2,3\n", InputError, "'q' occurs 2 times"),
        (b"x" * (2 << 20), DamagedFile, "no end within"),
        (b"," * 6000 + b"\n", InputError, "6001 columns"),
        (b"t,q\n1,2\n1,2,3\n", DamagedFile, "not a readable"),
    ],
)
def test_what_is_no_table_is_said_in_one_line(tmp_path: Path, content: bytes, kind: type, message: str) -> None:
    file = tmp_path / "log.csv"
    file.write_bytes(content)
    with pytest.raises(kind, match=message) as caught:
        read_text_table(file)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


@given(values=st.lists(st.floats(-1e6, 1e6, allow_nan=False), min_size=6, max_size=6), comma=st.booleans())
def test_numbers_survive_any_spelling(values: list[float], comma: bool) -> None:
    sign = "," if comma else "."
    lines = "".join(f"{a!r};{b!r}\n".replace(".", sign) for a, b in zip(values[::2], values[1::2], strict=True))
    file = Path(f"/dev/shm/btr-{abs(hash(lines))}.csv")
    try:
        file.write_text("a;b\n" + lines)
        (table,) = read_text_table(file)
        np.testing.assert_array_equal(np.stack([*table.columns.values()], axis=1).ravel(), values)
    finally:
        file.unlink(missing_ok=True)


def test_blocks_of_a_long_file_equal_the_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Decimal commas, a row of units and time in ms, in blocks of a few rows."""
    monkeypatch.setattr(text, "BLOCK_BYTES", 500)
    log, model = simulated_log(ARM, 1.0), mujoco.MjModel.from_xml_string(ARM)
    lines = ["# arm 3", "Zeit;q shoulder;q elbow;cmd shoulder;cmd elbow", "ms;deg;deg;deg;deg"]
    for t, q, u in zip(log.time, log.qpos, log.ctrl, strict=True):
        lines.append(";".join(f"{v:.6f}".replace(".", ",") for v in (1000 * t, *np.degrees(q), *np.degrees(u))))
    file = tmp_path / "log.csv"
    file.write_text("\r\n".join(lines).replace("Zeit", "time"))
    notes: list[str] = []
    found, _ = read_stretches([file], Share(1000, 100), model, notes, lambda count: None)
    whole = np.concatenate([columns["qpos/elbow"] for columns in found])
    rows = np.round(1000 * np.concatenate([columns["time"] for columns in found])).astype(int)
    np.testing.assert_allclose(whole, log.qpos[rows, 1], atol=1e-7)
    assert any("q shoulder from deg" in note for note in notes)
    assert any("in ms (as stated)" in note for note in notes)
    assert parse_rows(file, read_dialect(file), b"1;2;3;4;5\n").shape == (1, 5)


def test_columns_of_text_without_a_use_do_no_harm(tmp_path: Path) -> None:
    log = simulated_log(ARM, 0.5)
    (tmp_path / "arm.xml").write_text(ARM)
    rows = [f"{t:.4f},walk,{q[0]},{q[1]},{u[0]},{u[1]}" for t, q, u in zip(log.time, log.qpos, log.ctrl, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["time,mode,shoulder,elbow,shoulder_cmd,elbow_cmd", *rows]))
    data = open_logs(tmp_path / "arm.xml", [tmp_path / "log.csv"])
    assert any("without a use: mode" in note for note in data.recordings[0].notes)
    np.testing.assert_allclose(np.concatenate([r.qpos for r in data.recordings]), log.qpos, atol=1e-12)


def folder_of_a_log(folder: Path) -> Path:
    log = simulated_log(ARM)
    (folder / "arm.xml").write_text(ARM)
    table = np.column_stack([log.time, log.qpos, log.ctrl])
    names = "t,q_shoulder,q_elbow,shoulder_cmd,elbow_cmd"
    np.savetxt(folder / "run.csv", table, delimiter=",", header=names, comments="")
    return folder


@pytest.mark.parametrize(
    ("name", "content"),
    [
        (
            "expected.txt",
            "Source: issue #132, 0.08 N m/rad at the knee.\nRight: joint_stiffness 0.08, at joint:knee.\n",
        ),
        ("notes.log", "run 1, the cable was loose\n"),
        ("names.csv", "time,q_shoulder,q_elbow\n"),
    ],
)
def test_notes_beside_logs_are_left_out_and_told(tmp_path: Path, name: str, content: str) -> None:
    folder = folder_of_a_log(tmp_path)
    (folder / name).write_text(content)
    data = open_dataset(folder)
    assert {one.name.split(" ")[0] for one in data.recordings} == {"run"}
    assert any(note.startswith(f"{name}: text without a row of numbers") for note in data.notes)
    with pytest.raises(InputError, match=name):  # who names a file means it
        open_logs(folder / "arm.xml", [folder / "run.csv", folder / name])


@pytest.mark.parametrize("content", ["", "time,q\n1,2\n".encode("utf-16")], ids=["empty", "UTF-16"])
def test_a_log_that_was_lost_is_no_note(tmp_path: Path, content: str | bytes) -> None:
    folder = folder_of_a_log(tmp_path)
    (folder / "run2.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises((InputError, DamagedFile), match=r"run2\.csv"):
        open_dataset(folder)
