"""Runs that are killed at any moment and resumed end as an uninterrupted one."""

from pathlib import Path

import faults
import pytest
from fault_runs import RUNS, Run


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_a_run_that_is_killed_anywhere_ends_as_an_uninterrupted_one(name: str, tmp_path: Path) -> None:
    run = RUNS[name].prepared(tmp_path)
    whole = run.session(tmp_path / "whole")
    assert whole.code == 0, whole.text
    expected = faults.content(tmp_path / "whole" / "run")
    for moment in faults.kill_points(whole.changes, 14):
        folder = tmp_path / f"killed-{moment}"
        assert run.session(folder, kill_at=moment).killed
        resumed = run.session(folder, resume=(folder / "run").exists())
        assert resumed.code == 0, resumed.text
        assert faults.content(folder / "run") == expected, f"killed before change {moment} of {whole.changes}"


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_a_run_that_is_killed_again_and_again_ends_as_an_uninterrupted_one(name: str, tmp_path: Path) -> None:
    run: Run = RUNS[name].prepared(tmp_path)
    whole = run.session(tmp_path / "whole")
    assert whole.code == 0, whole.text
    folder, kills, moment = tmp_path / "killed", 0, 3
    while (session := run.session(folder, resume=(folder / "run").exists(), kill_at=moment)).killed:
        kills, moment = kills + 1, moment + 2  # a session needs some changes to take up where the last one ended
    assert session.code == 0, session.text
    assert kills >= 3
    assert faults.content(folder / "run") == faults.content(tmp_path / "whole" / "run")
