"""What the command of a diagnosis refuses, in one line, and what `--check` says; nothing is searched."""

import json
from pathlib import Path

import numpy as np
import pytest

from btr_mjx import diagnose


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ([], "got no dataset"),
        (["DATA", "--demo"], "and --demo"),
        (["DATA", "--max-effects", "0"], "max_effects: got 0"),
        (["DATA", "--effects", "dry_frictoin"], "'dry_frictoin' is not in the library; nearest: 'dry_friction'"),
        (["DATA", "--effects", "nowhere.py:MINE"], "there is no file nowhere.py"),
        (["nowhere"], "there is no such file or folder"),
        (["DATA", "--resume"], "say which run to continue"),
    ],
)
def test_bad_settings_are_one_line(
    folder: Path, searches: list, capsys: pytest.CaptureFixture[str], flags: list[str], message: str, tmp_path: Path
) -> None:
    flags = [str(folder) if flag == "DATA" else flag for flag in flags]
    if "--resume" not in flags:
        flags += ["--out", str(tmp_path / "run")]
    with pytest.raises(SystemExit) as stop:
        diagnose.main(flags)
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()
    assert not searches


def test_unusable_data_are_one_line(folder: Path, searches: list, capsys: pytest.CaptureFixture[str]) -> None:
    with np.load(folder / "behaviour_01.npz") as archive:
        columns = dict(archive)
    columns = {name: values if name == "time" else np.degrees(values) for name, values in columns.items()}
    for name in ("behaviour_01", "behaviour_02", "behaviour_03"):
        np.savez(folder / f"{name}.npz", **columns)
    with pytest.raises(SystemExit) as stop:
        diagnose.main([str(folder), "--out", str(folder.parent / "run")])
    assert stop.value.code == 2
    assert "looks like degrees" in capsys.readouterr().err


def test_check_writes_nothing_and_prints_findings(
    folder: Path, searches: list, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    diagnose.main([str(folder), "--check"])
    out = capsys.readouterr().out
    assert "2 recordings to fit and 1 held out" in out
    assert out.endswith("the data can be used\n")
    diagnose.main([str(folder), "--check", "--json"])
    answer = json.loads(capsys.readouterr().out)
    assert answer["usable"]
    assert {"level", "topic", "message", "remedy", "evidence", "lines"} == set(answer["findings"][0])
    assert not searches
    assert sorted(tmp_path.rglob("*")) == before


def test_check_and_search_refuse_the_same_data(
    folder: Path, searches: list, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for file in folder.glob("behaviour_*.npz"):
        columns = dict(np.load(file))
        np.savez(file, **(columns | {"qvel/servo": -columns["qvel/servo"]}))
    words = "qvel/servo has the opposite sign of the slope of its positions"
    with pytest.raises(SystemExit) as stopped:
        diagnose.main([str(folder), "--check", "--json"])
    assert stopped.value.code == 2
    answer = json.loads(capsys.readouterr().out)
    assert not answer["usable"]
    (error,) = (f for f in answer["findings"] if f["level"] == "error")
    assert words in error["message"]
    assert error["remedy"] == "negate either of qpos/servo and qvel/servo, or leave the velocity out"
    assert error["evidence"]["error_now"] > 5 * error["evidence"]["error_with_remedy"]
    with pytest.raises(SystemExit) as stopped:
        diagnose.main([str(folder), "--out", str(tmp_path / "run"), "--no-progress"])
    assert stopped.value.code == 2
    assert f"error: fix the data first: {words}" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert not searches


def test_check_of_data_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "dataset.toml").write_text("[model]\nfile = 3\n")
    for more in ([], ["--json"]):
        with pytest.raises(SystemExit) as stopped:
            diagnose.main([str(tmp_path), "--check", *more])
        assert stopped.value.code == 2
    out, err = capsys.readouterr()
    assert err.startswith("error: ")
    (finding,) = json.loads(out)["findings"]
    assert (finding["level"], finding["topic"]) == ("error", "loading")


@pytest.mark.parametrize(("words", "message"), [(["--check", "--demo"], "--check and --demo"), (["--json"], "--json")])
def test_flags_of_check(words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = words if "--demo" in words else [str(tmp_path), *words]
    with pytest.raises(SystemExit) as stopped:
        diagnose.main(given)
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err
