"""Cases that resemble what users bring: their simulation against plain MuJoCo, and what is written of them."""

from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import open_dataset

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def physics(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    from hidden_cases import field_physics

    return field_physics


@pytest.fixture
def cases(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    from hidden_cases import field_cases

    return field_cases


def commanded(physics: ModuleType, kind: str, duration: float = 0.5):
    from hidden_cases.field_robots import ROBOTS

    robot = ROBOTS[kind](np.random.default_rng(5))
    times = np.arange(-round(physics.SETTLE / robot.step), round(duration / robot.step)) * robot.step
    reference = robot.reference(np.random.default_rng(6))(times)
    return robot, physics.Controlled(robot, reference, 10 if robot.controller else 1)


@pytest.mark.parametrize("kind", ["arm", "torque_arm", "pendulum", "gantry", "drone"])
def test_a_perfect_null_is_the_believed_model_at_fine_steps(physics: ModuleType, kind: str) -> None:
    robot, control = commanded(physics, kind)
    model = mujoco.MjModel.from_xml_string(robot.xml)
    motion = physics.move(physics.build(robot, physics.Calibration.perfect(model)), control)
    model.opt.timestep = robot.step
    data, skipped = mujoco.MjData(model), round(physics.SETTLE / robot.step)
    for i, reference in enumerate(control.reference):
        if i >= skipped:
            assert np.abs(data.qpos - motion.qpos[i - skipped]).max() < 1e-9
        if robot.controller is None:
            data.ctrl[:] = reference
        elif i % control.every == 0:
            data.ctrl[:] = robot.controller(reference, data.qpos, data.qvel)
        mujoco.mj_step(model, data)


def test_hidden_friction_is_that_of_mujoco(physics: ModuleType) -> None:
    robot, control = commanded(physics, "pendulum", 1.5)
    believed = mujoco.MjModel.from_xml_string(robot.xml)
    perfect = physics.Calibration.perfect(believed)
    hidden = [{"effect": "dry_friction", "location": "joint:pivot", "parameters": {"torque": 0.1}}]
    plain, rubbed = (physics.move(physics.build(robot, perfect, some), control).qpos for some in ((), hidden))
    machine = physics.build(robot, perfect)
    machine.model.dof_frictionloss += 0.1
    oracle = physics.move(machine, control).qpos
    assert np.abs(rubbed - plain).max() > 0.05
    assert np.abs(rubbed - oracle).max() < 0.02 * np.abs(rubbed - plain).max()


@pytest.mark.parametrize(
    ("name", "location", "parameters", "field"),
    [
        ("viscous_damping", "joint:pivot", {"damping": 0.05}, "dof_damping"),
        ("joint_stiffness", "joint:pivot", {"stiffness": 0.5}, "jnt_stiffness"),
        ("armature", "joint:pivot", {"armature": 0.01}, "dof_armature"),
    ],
)
def test_hidden_forces_are_numbers_of_the_model(
    physics: ModuleType, name: str, location: str, parameters: dict[str, float], field: str
) -> None:
    robot, control = commanded(physics, "pendulum")
    perfect = physics.Calibration.perfect(mujoco.MjModel.from_xml_string(robot.xml))
    effect = {"effect": name, "location": location, "parameters": parameters}
    moved = physics.move(physics.build(robot, perfect, [effect]), control).qpos
    machine = physics.build(robot, perfect)
    array = getattr(machine.model, field)
    array[(0,) * array.ndim] += next(iter(parameters.values()))
    apart = np.abs(moved - physics.move(machine, control).qpos).max()
    assert apart < 2e-3 * np.abs(moved - physics.move(physics.build(robot, perfect), control).qpos).max()


def test_a_delay_is_a_shift_of_commands(physics: ModuleType) -> None:
    robot, control = commanded(physics, "arm")
    perfect = physics.Calibration.perfect(mujoco.MjModel.from_xml_string(robot.xml))
    effect = {"effect": "actuator_delay", "location": "all", "parameters": {"delay": 0.02}}
    late = physics.move(physics.build(robot, perfect, [effect]), control).qpos
    steps = round(0.02 / robot.step)
    shifted = np.concatenate([np.repeat(control.reference[:1], steps, 0), control.reference[:-steps]])
    assert (
        np.abs(late - physics.move(physics.build(robot, perfect), physics.Controlled(robot, shifted)).qpos).max() == 0
    )


def test_held_commands_change_ahead_of_the_rows(physics: ModuleType) -> None:
    robot, control = commanded(physics, "arm")
    perfect = physics.Calibration.perfect(mujoco.MjModel.from_xml_string(robot.xml))
    held = physics.Controlled(robot, control.reference, every=50, ahead=20)
    commands = physics.move(physics.build(robot, perfect), held).commands
    changes = 1 + np.flatnonzero((np.diff(commands, axis=0) != 0).any(1))
    assert set(changes % 50) == {30}  # 20 fine steps before rows 50, 100, ...
    later = control.reference[round(physics.SETTLE / robot.step) :]
    assert np.array_equal(commands[changes], later[changes])


@pytest.mark.parametrize("fault", ["jitter", "coarse", "held", "lowpass", "late", "lost"])
def test_logs_with_faults_are_read(
    cases: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    monkeypatch.setattr(cases, "DURATION", 1.0)
    truth = cases.make_case(tmp_path, 4, "pendulum", cases.Wanted(effects=0, faults=(fault,)))
    dataset = open_dataset(tmp_path)
    assert truth["effects"] == []
    assert truth["faults"] == [fault]
    assert len(dataset.recordings) >= 3
    if fault == "coarse":
        values = dataset.recordings[0].qpos / 5e-3
        assert np.abs(values - np.round(values)).max() < 1e-4
    if fault == "late":
        assert truth["late"] > 0


def test_cases_are_the_same_again(cases: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "DURATION", 0.5)
    truths = [cases.make_case(tmp_path / name, 9, "gantry") for name in ("one", "other")]
    assert truths[0] == truths[1]
    assert [(tmp_path / name / "run3.csv").read_bytes() for name in ("one",)] == [
        (tmp_path / "other/run3.csv").read_bytes()
    ]
