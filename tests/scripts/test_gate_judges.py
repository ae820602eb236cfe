"""Judges of the gate: which names, sizes and forces are right."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from gates import suites
from gates.forces import judge_drives, judge_law
from gates.names import judge_names, same_place, true_values
from gates.rows import NO_ANSWER
from hidden_cases import case_robot
from hidden_cases.field_cases import FAULTS
from hidden_cases.field_robots import ROBOTS
from toy_gate import answer, named

DOG, ARM = case_robot("quadruped").model, case_robot("arm").model


def field_model(kind: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ROBOTS[kind](np.random.default_rng(0)).xml)


def effect(name: str, location: str, **values: float) -> dict[str, Any]:
    return {"effect": name, "location": location, "parameters": values}


def test_names_are_right_or_false() -> None:
    model = field_model("pendulum")
    rubbing = effect("dry_friction", "joint:pivot", torque=0.2)
    good = named("dry_friction", "joint:pivot", torque=0.25)
    common, late = (named("actuator_delay", place, delay=-0.01) for place in ("all", "actuator:pivot"))
    row = judge_names(model, [rubbing], answer(good))
    assert (row.right, row.false_names, row.numbers, row.inside, row.is_null) == (True, (), 1, 1, False)
    row = judge_names(model, [rubbing], answer(good, late))
    assert (row.right, row.false_names, row.inside) == (False, ("actuator_delay@actuator:pivot",), 1)
    assert judge_names(model, [rubbing], answer(verdict="unexplained")).right is False
    assert judge_names(model, [rubbing], answer(good, verdict="unexplained")).right is False
    assert judge_names(model, [rubbing], answer(), detectable=False).right is None
    assert judge_names(model, [rubbing], answer(verdict=NO_ANSWER)).right is False
    # Nothing is hidden where commands were logged late: that is a fault of the log, not an effect of the robot.
    row = judge_names(model, [], answer(common))
    assert (row.right, row.false_names, row.is_null) == (False, ("actuator_delay@all",), True)
    assert judge_names(model, [], answer()).right
    assert judge_names(model, [], answer(verdict="unexplained")).right is False
    assert judge_names(model, [], answer(verdict=NO_ANSWER)).right is False


def test_what_is_outside_the_library_is_called_unexplained_or_a_law_of_its_kind() -> None:
    model = field_model("pendulum")
    hidden = {"outside": "ripple@joint:pivot", "laws": ["law_ripple@joint:pivot"]}
    ripple, drag = (named(law, "joint:pivot", torque=0.1) for law in ("law_ripple", "law_drag"))
    for said, right in ((answer(verdict="unexplained"), True), (answer(ripple), True), (answer(drag), False)):
        assert judge_names(model, [], said, **hidden).right is right
    assert judge_names(model, [], answer(), **hidden).right is False
    assert judge_names(model, [], answer(), **hidden).is_null is False


def test_a_number_for_every_joint_is_right_where_the_others_may_be_zero() -> None:
    model, rubbing = field_model("torque_arm"), effect("dry_friction", "joint:lower", torque=0.2)
    for other, false in ((0.05, ()), (0.3, ("dry_friction@each:all",))):
        each = named("dry_friction", "each:all", torque__lower=0.25, torque__upper=other)
        row = judge_names(model, [rubbing], answer(each))
        assert (row.inside, row.right, row.false_names) == (1, not false, false)
    every = effect("dry_friction", "each:all", **{"torque[lower]": 0.2, "torque[upper]": 0.05})
    row = judge_names(model, [every], answer(each))
    assert (row.right, row.numbers, row.inside) == (True, 2, 1)
    assert judge_names(model, [every], answer(named("dry_friction", "all", torque=0.2))).right is False


def test_rotors_have_only_their_names() -> None:
    model, weak = field_model("drone"), effect("actuator_gain", "actuator:rotor1", change=-0.2)
    for place, right in (("actuator:rotor1", True), ("actuator:rotor2", False), ("all", False)):
        assert judge_names(model, [weak], answer(named("actuator_gain", place, change=-0.2))).right is right


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("joint:fl_knee", "actuator:fl_knee", True),
        ("joint:fl_knee", "joint:fr_knee", False),
        ("subtree:fl_hip", "all", False),
        ("subtree:fl_hip", "subtree:fl_hip", True),
        ("body:fl_thigh", "body:fl_shank", False),
        ("world", "geom:floor", True),
        ("world", "body:trunk", False),
    ],
)
def test_places(one: str, other: str, same: bool) -> None:
    assert same_place(DOG, one, other) == same_place(DOG, other, one) == same


def test_changes_are_right_by_name_and_size(tmp_path: Path) -> None:
    (tmp_path / "before").mkdir()
    (tmp_path / "before" / "model.xml").write_text(ROBOTS["torque_arm"](np.random.default_rng(0)).xml)
    truth = {"effects": [effect("dry_friction", "joint:lower", torque=0.1)]}
    single = [named("dry_friction", "joint:lower", torque=size) for size in (0.11, 0.13)]
    each = named("dry_friction", "each:all", torque__lower=0.11, torque__upper=0.05)
    for said, right in ((single[0], True), (single[1], False), (each, True)):
        assert suites.judge_change(tmp_path, truth, answer(said)).right is right
    assert suites.judge_change(tmp_path, truth, answer()).right is False
    assert suites.judge_change(tmp_path, {"effects": []}, answer()).right is True


def test_laws_are_right_by_their_force(tmp_path: Path) -> None:
    """A belt that pulls a joint only by its own angle is a spring, by another name."""
    robot, rng = ROBOTS["arm"](np.random.default_rng(0)), np.random.default_rng(1)
    model, data = mujoco.MjModel.from_xml_string(robot.xml), tmp_path / "data"
    data.mkdir()
    (data / "model.xml").write_text(robot.xml)
    states = {"qpos": model.nq, "qvel": model.nv, "torque": model.nv}
    drawn = {name: rng.standard_normal((20, size)) for name, size in states.items()}
    np.savez(tmp_path / "fresh.npz", time=np.arange(20.0), **drawn)
    own, other = (model.joint(int(model.actuator_trnid[a, 0])).name for a in (0, 1))
    belt = effect("law", f"joint:{own}", p0=2.0, p1=0.0) | {"kind": "coupling", "other": other}
    springs = [named("joint_stiffness", f"joint:{own}", stiffness=k) for k in (2.2, 4.0)]
    truth = {"robot": "arm", "effects": [belt]}
    row = judge_law(data, truth, answer(springs[0]))
    assert (row.right, row.false_names, row.hidden) == (True, (), f"coupling@joint:{own}")
    row = judge_law(data, truth, answer(springs[1]))
    assert (row.right, row.false_names) == (False, (f"joint_stiffness@joint:{own}",))
    unexplained = answer(verdict="unexplained")
    assert judge_law(data, truth, unexplained).right is False
    assert judge_law(data, truth | {"robot": "legged"}, unexplained).right is True
    dead = {"robot": "arm", "effects": [effect("backlash", f"joint:{own}", play=0.1)]}
    assert judge_law(data, dead, answer(named("backlash", f"joint:{own}", play=0.3))).right is True


def test_drives_are_right_where_friction_and_rotors_are_near(tmp_path: Path) -> None:
    truth = {"friction": [1.0] * 6, "damping": [1.0] * 6, "rotor": [0.2] * 6}
    rotors = named("armature", "each:all", **{f"armature__j{i}": 0.21 for i in range(6)})
    said = answer(rotors, named("dry_friction", "all", torque=1.05)) | {"calibration": []}
    row = judge_drives(tmp_path, truth, said)
    assert (row.right, row.numbers, row.inside, row.false_names) == (True, 18, 12, ())
    said["calibration"] = [named("dry_friction", "joint:j3", torque=0.2)]
    row = judge_drives(tmp_path, truth, said)
    assert (row.right, row.inside) == (False, 11)


def test_hidden_payloads_in_the_parameters_of_the_library() -> None:
    hidden = effect("payload", "body:lower", mass=0.3, x=0.2, y=0.0, z=0.0)
    np.testing.assert_allclose(true_values(ARM, hidden, ["mass", "along"]), [0.3, 0.2])
    np.testing.assert_allclose(true_values(ARM, hidden, ["mass", "x", "y", "z"]), [0.3, 0.2, 0, 0])


def test_every_robot_meets_every_fault() -> None:
    wanted = [suites.wanted(index, "", True) for index in range(60)]
    met = {(robot, fault) for robot, some in wanted for fault in some.faults or ()}
    assert met == {(robot, fault) for robot in suites.TURN for fault in FAULTS}
    assert all(some.effects == 0 and len(set(some.faults or ())) == len(some.faults or ()) for _, some in wanted)
