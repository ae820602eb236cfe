"""The benchmark of units: its logs are refused with the unit's name, and pass once the printed lines are followed."""

from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.slow
def test_a_log_in_half_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import log_units

    folder = tmp_path / "case"
    robot, _ = log_units.draw(folder, "torque_arm", 0)
    assert log_units.passes(log_units.check(folder))
    unit = log_units.ANGLES["half turns"]
    log_units.count_in(folder, robot, unit)
    found = log_units.check(folder)
    assert any(finding.level == "error" and unit.words[0] in finding.message for finding in found)
    assert log_units.passes(log_units.after_pasting(folder, found))
