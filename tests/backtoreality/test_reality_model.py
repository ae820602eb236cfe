"""A reality that is a model file: exactly that model, and as the truth what the file says."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import btr_mjx as btr
from btr_mjx import coevolve
from btr_mjx.backtoreality import PRESETS, SimulatedReality, build_problem
from btr_mjx.errors import InputError

EXAMPLES = Path(__file__).parents[2] / "examples"
THROWER = (EXAMPLES / "thrower" / "robot.xml").read_text()

ROBOT = """
model = "robot.xml"
point = "hand"
duration = 0.3
fitness = "target_distance"
target = [0.35, 0.0, 1.3]
[[parameter]]
name = "ball mass"
path = "body:ball/mass"
bounds = [0.05, 0.6]
[[parameter]]
name = "damping"
path = ["joint:shoulder/damping", "joint:elbow/damping"]
relative = true
bounds = [0.2, 3.0]
[controller]
signal = "spline"
knots = 4
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.xml").write_text(THROWER)
    (tmp_path / "robot.toml").write_text(ROBOT)
    return tmp_path


def reality_of(folder: Path, text: str, seed: int = 0, name: str = "real.xml", **more: object) -> SimulatedReality:
    (folder / name).write_text(text)
    config = replace(PRESETS["quick"], robot=folder, reality_model=folder / name, seed=seed, **more)  # type: ignore[arg-type]
    reality = build_problem(config).reality
    assert isinstance(reality, SimulatedReality)
    return reality


def distance_by_mujoco(file: Path, robot: btr.Robot, controller: np.ndarray) -> float:
    """Distance of the hand from the target [m] at the end of a trial in the model of a file, step by step."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    for step in range(round(robot.duration / model.opt.timestep)):
        data.ctrl[:] = robot.signal(controller[:, None], step * model.opt.timestep, np)[:, 0]
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    return float(np.linalg.norm(data.site("hand").xpos - robot.target))


@pytest.mark.parametrize("seed", [0, 1])
def test_it_is_the_model_of_the_file(folder: Path, seed: int) -> None:
    """Whatever the seed draws, native MuJoCo with the file as it is measures the same."""
    text = THROWER.replace('mass="0.15"', 'mass="0.31"').replace('"elbow" damping="0.2"', '"elbow" damping="0.9"')
    reality = reality_of(folder, text, seed)
    robot = btr.load_robot(folder)
    controllers = robot.controller_box.sample(np.random.default_rng(seed), 3)
    expected = [distance_by_mujoco(folder / "real.xml", robot, c) for c in controllers]
    np.testing.assert_allclose(reality.measure(controllers)[:, 0], expected, rtol=1e-9)


def test_the_truth_is_what_the_file_says(folder: Path) -> None:
    heavy = THROWER.replace('mass="0.15"', 'mass="0.31"')
    np.testing.assert_allclose(reality_of(folder, heavy).true_values, [0.31, 1.0])
    both = heavy.replace('damping="0.3"', 'damping="0.6"').replace('damping="0.2"', 'damping="0.4"')
    np.testing.assert_allclose(reality_of(folder, both).true_values, [0.31, 2.0])
    # No factor makes the believed dampings these two, and no mass of a body that is not there can be told.
    one = heavy.replace('damping="0.3"', 'damping="0.6"')
    np.testing.assert_allclose(reality_of(folder, one).true_values, [0.31, np.nan])
    other = THROWER.replace('<body name="ball"', '<body name="sphere"')
    np.testing.assert_allclose(reality_of(folder, other).true_values, [np.nan, 1.0])


def test_variables_of_a_template_are_drawn_or_given(tmp_path: Path) -> None:
    """The same MJCF as a template plays reality with what is drawn; what stands as a number is not touched."""
    hidden = ROBOT.replace('name = "ball mass"\npath = "body:ball/mass"\n', 'name = "ball"\nnominal = 0.2\n')
    (tmp_path / "robot.toml").write_text(hidden.replace("robot.xml", "robot.xml.j2"))
    template = THROWER.replace('mass="0.15"', 'mass="{{ ball }}"')
    (tmp_path / "robot.xml.j2").write_text(template)
    drawn = [reality_of(tmp_path, template, seed, "real.xml.j2").true_values for seed in (0, 1)]
    assert drawn[0][0] != drawn[1][0]
    assert (drawn[0][1], drawn[1][1]) == (1.0, 1.0)
    given = reality_of(tmp_path, template, 0, "real.xml.j2", truth=("ball=0.4",))
    np.testing.assert_allclose(given.true_values, [0.4, 1.0])
    controllers = given.robot.controller_box.sample(np.random.default_rng(0), 2)
    (tmp_path / "plain.xml").write_text(template.replace("{{ ball }}", "0.4"))
    expected = [distance_by_mujoco(tmp_path / "plain.xml", given.robot, c) for c in controllers]
    np.testing.assert_allclose(given.measure(controllers)[:, 0], expected, rtol=1e-9)
    # A file with the number in place of the variable does not say which value that is.
    np.testing.assert_allclose(reality_of(tmp_path, THROWER, 0, "real.xml").true_values, [np.nan, 1.0])


def test_a_number_of_the_file_takes_no_other_value(folder: Path) -> None:
    with pytest.raises(InputError, match=r"truth ball mass: the reality is .*real\.xml.*change it there"):
        reality_of(folder, THROWER, truth=("ball mass=0.3",))


def test_a_joint_of_another_type_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="joint elbow is of another type"):
        reality_of(folder, THROWER.replace('name="elbow" damping', 'name="elbow" type="slide" damping'))


def test_results_show_what_is_known(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The table, result.json and the error of the parameters hold the file's numbers, none that was drawn."""
    text = THROWER.replace('mass="0.15"', 'mass="0.31"').replace('damping="0.3"', 'damping="0.6"')
    (folder / "real.xml").write_text(text)
    out = folder / "run"
    flags = ("--trials=4", "--controllers=8", "--controller-generations=2", "--simulations=8", "--no-progress")
    more = ("--simulation-generations=2", "--iterations=1", "--engine=native", "--no-figures")
    coevolve.main([f"--robot={folder}", f"--reality-model={folder / 'real.xml'}", f"--out={out}", *flags, *more])
    result = json.loads((out / "result.json").read_text())
    assert result["truth"] == pytest.approx({"ball mass": 0.31})
    assert result["parameter_error_last"] == pytest.approx(abs(result["simulation"]["ball mass"] - 0.31))
    lines = {line.split("  ")[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "0.31" in lines["ball mass"].split()
    assert (
        len(lines["damping"].split("not told")[0].split()) == len(lines["ball mass"].split("not told")[0].split()) - 2
    )
