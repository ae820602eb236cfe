"""The gate of field cases: how answers are judged, and how two files of answers are compared."""

from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest

from btr_mjx.runs import write_json

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    import field_gate

    return field_gate


def model_of(kind: str) -> mujoco.MjModel:
    from hidden_cases.field_robots import ROBOTS

    return mujoco.MjModel.from_xml_string(ROBOTS[kind](np.random.default_rng(0)).xml)


def effect(name: str, location: str, **values: float) -> dict[str, Any]:
    return {"effect": name, "location": location, "parameters": values}


def named(name: str, location: str, parameter: str, value: float) -> dict[str, Any]:
    number = {"value": value, "low": value - 0.1, "high": value + 0.1, "null": 0.0}
    return {"effect": name, "location": location, "parameters": {parameter: number}}


def truth(*effects: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"robot": "pendulum", "effects": list(effects), "visible": [], "faults": [], "late": 0.0} | more


def answer(*effects: dict[str, Any], verdict: str | None = None) -> dict[str, Any]:
    said = verdict or ("effect" if effects else "none")
    return {"verdict": said, "effects": list(effects), "equivalent": [], "unexplained": []} | {
        "cpu_seconds": 1.0,
        "sentence": "",
    }


def test_names_are_right_or_false(gate: ModuleType) -> None:
    model = model_of("pendulum")
    rubbing = effect("dry_friction", "joint:pivot", torque=0.2)
    good = named("dry_friction", "joint:pivot", "torque", 0.25)
    late = named("actuator_delay", "actuator:pivot", "delay", -0.01)
    common = named("actuator_delay", "all", "delay", -0.01)
    right = gate.judge(model, truth(rubbing), answer(good))
    assert (right["right"], right["numbers"], right["inside"], right["correct"]) == (1, 1, 1, True)
    both = gate.judge(model, truth(rubbing), answer(good, late))
    assert both["right"] == 1
    assert both["extra"] == ["actuator_delay@actuator:pivot"]
    assert not both["correct"]
    # Commands that were logged late are a fault of the log, not an effect of the robot.
    assert not gate.judge(model, truth(late=0.01), answer(common))["correct"]
    assert gate.judge(model, truth(late=0.01), answer())["correct"]
    assert gate.judge(model, truth(), answer())["correct"]
    assert gate.judge(model, truth(), answer(verdict="unexplained"))["false_unexplained"]
    ripple = effect("ripple", "joint:pivot", torque=0.1, waves=9.0)
    flagged = gate.judge(model, truth(ripple), answer(verdict="unexplained"))
    assert flagged["flagged"]
    assert flagged["correct"]


def test_a_number_for_every_joint_is_right_where_the_others_may_be_zero(gate: ModuleType) -> None:
    model, rubbing = model_of("torque_arm"), effect("dry_friction", "joint:lower", torque=0.2)
    for other, extra in ((0.05, []), (0.3, ["dry_friction@each:all"])):
        each = named("dry_friction", "each:all", "torque[lower]", 0.25)
        each["parameters"] |= named("", "", "torque[upper]", other)["parameters"]
        row = gate.judge(model, truth(rubbing), answer(each))
        assert (row["right"], row["inside"], row["extra"]) == (1, 1, extra)


def test_rotors_have_only_their_names(gate: ModuleType) -> None:
    model = model_of("drone")
    weak = effect("actuator_gain", "actuator:rotor1", change=-0.2)
    for place, right in (("actuator:rotor1", 1), ("actuator:rotor2", 0), ("all", 0)):
        row = gate.judge(model, truth(weak), answer(named("actuator_gain", place, "change", -0.2)))
        assert row["right"] == right


def test_files_are_compared(gate: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, rows = model_of("pendulum"), {}
    for name, said in (("before", answer(verdict="unexplained")), ("after", answer())):
        rows[name] = [{"case": "one", **gate.judge(model, truth(), said)}]
        write_json(tmp_path / f"{name}.json", {"rows": rows[name]})
    gate.compare(tmp_path / "before.json", tmp_path / "after.json")
    printed = capsys.readouterr().out
    assert "only_after 1" in printed
    assert "one, hidden nothing: unexplained nothing -> none nothing" in printed
    gate.show(rows["after"])
    assert "pendulum" in capsys.readouterr().out


def test_every_robot_meets_every_fault(gate: ModuleType) -> None:
    wanted = [gate.wanted_of(gate.Config(nulls=True), index) for index in range(60)]
    met = {(robot, fault) for robot, some in wanted for fault in some.faults}
    assert met == {(robot, fault) for robot in gate.TURN for fault in gate.FAULTS}
    assert all(some.effects == 0 and len(set(some.faults)) == len(some.faults) for _, some in wanted)
