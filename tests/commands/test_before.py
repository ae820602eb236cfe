"""`diagnose --before`: bad input in one line, and a run folder that says what has changed and resumes."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from gap_results import FOUND
from hidden_cases import CaseSettings, make_case

from btr_mjx import diagnose
from btr_mjx.errors import BAD_INPUT_CODE, InputError
from btr_mjx.gap import forces
from btr_mjx.gap.forces import Changes
from btr_mjx.gap.results import (
    Estimate,
    NamedEffect,
    Quantity,
)

MISSING = NamedEffect("viscous_damping", "joint:servo", {"damping": Estimate(0.01, 0.009, 0.011, "N m s/rad")}, 50, 9)
CHANGE = NamedEffect("dry_friction", "joint:servo", {"torque": Estimate(-0.031, -0.034, -0.028, "N m")}, 80.0, 30.0)
BEFORE = dataclasses.replace(FOUND, found=(MISSING,), ranking=(), equivalent=(), confounds=(), overlays=())
AFTER = dataclasses.replace(BEFORE, found=(CHANGE,), calibration=(MISSING,))


def wear(count: int) -> Quantity:
    """A number that falls in the last of so many sets."""
    value, low, high = ((*[0.0] * (count - 1), last) for last in (-0.031, -0.034, -0.028))
    return Quantity("dry_friction", "joint:servo", "torque", "N m", value, low, high, (*[False] * (count - 1), True))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_case(tmp_path / "before", 4, "pendulum", CaseSettings(verdict="none", recordings=(2, 1), duration=0.8))
    shutil.copytree(tmp_path / "before", tmp_path / "after")
    return tmp_path


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Folders of the sets of each search; a stand-in answers."""
    calls: list[list[str]] = []

    def stand_in(sets: Any, *_: Any) -> Changes:
        calls.append([one.folder.name for one in sets])
        return Changes((*[BEFORE] * (len(sets) - 1), AFTER), (wear(len(sets)),))

    monkeypatch.setattr(forces, "identify_changes", stand_in)
    return calls


def test_a_run_says_what_has_changed_and_what_was_said_before(
    folder: Path, searches: list, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = [str(folder / "after"), "--before", str(folder / "before"), "--out", str(folder / "run"), "--no-progress"]
    diagnose.main(flags)
    out = capsys.readouterr().out
    said = "Dry friction at joint servo has fallen by 0.0310 ± 0.0030 N m since; nothing else has changed."
    assert said in " ".join(out.split())
    assert searches == [["before", "after"]]
    result = json.loads((folder / "run/result.json").read_text())
    assert result["sentence"].startswith(said)
    assert [e["effect"] for e in result["effects"]] == ["dry_friction"]
    assert result["before"]["verdict"] == "effect"
    assert [e["effect"] for e in result["before"]["effects"]] == ["viscous_damping"]
    assert result["before"]["sentence"].startswith("The missing effect is viscous damping")
    # The model after the change has what was found before, too.
    assert "damping" in (folder / "run/mended.xml").read_text()
    assert (folder / "run/sets.csv").read_text().count("dry_friction") == 2
    page = (folder / "run/report.html").read_text()
    assert "What has changed" in page
    assert "The missing effect is viscous damping" in page
    diagnose.main([*flags, "--resume"])
    assert len(searches) == 1
    assert said in " ".join(capsys.readouterr().out.split())


def test_several_earlier_sets_go_from_old_to_new(folder: Path, searches: list) -> None:
    shutil.copytree(folder / "before", folder / "older")
    earlier = ["--before", str(folder / "older"), "--before", str(folder / "before")]
    diagnose.main([str(folder / "after"), *earlier, "--out", str(folder / "run"), "--no-progress", "--no-figures"])
    assert searches == [["older", "before", "after"]]
    result = json.loads((folder / "run/result.json").read_text())
    assert len(result["sets"]) == 2
    assert "since;" in result["sets"][1]["sentence"]


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--before", "nowhere"], "--before nowhere: there is no such file or folder"),
        (["--before", ".", "--check"], "got --before and --check"),
        (["--before", ".", "--signal", "fitness"], "got --before and --signal fitness"),
    ],
)
def test_bad_flags_are_refused_in_one_line(
    folder: Path, flags: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        diagnose.main([str(folder / "after"), *flags, "--out", str(folder / "run")])
    assert stopped.value.code == BAD_INPUT_CODE
    error = capsys.readouterr().err.strip()
    assert said in error
    assert len(error.splitlines()) == 1


def test_another_robot_is_refused_with_both_names(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_case(folder / "arm", 6, "arm", CaseSettings(verdict="none", recordings=(1, 1), duration=0.5))
    with pytest.raises(SystemExit) as stopped:
        diagnose.main([str(folder / "after"), "--before", str(folder / "arm"), "--out", str(folder / "run")])
    assert stopped.value.code == BAD_INPUT_CODE
    error = capsys.readouterr().err
    assert "not the same robot" in error
    assert str(folder / "arm") in error
    assert str(folder / "after") in error


def test_texts_in_python_stand_for_paths(tmp_path: Path) -> None:
    for given, message in (
        ({"dataset": "nowhere"}, "nowhere: there is no such file or folder"),
        ({"dataset": str(tmp_path), "before": str(tmp_path / "absent")}, "--before .*absent: there is no such"),
        ({"dataset": str(tmp_path), "max_effect": 3}, "no setting 'max_effect'; nearest: 'max_effects'"),
    ):
        with pytest.raises(InputError, match=message):
            diagnose.diagnose(**given, out=str(tmp_path / "run"))
    assert not (tmp_path / "run").exists()
