"""Robots from a robot.toml: what it describes, and what is wrong with it."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import btr_mjx as btr
from btr_mjx.errors import InputError
from btr_mjx.evaluation import fitness_function, fitness_of
from btr_mjx.models import base_model, compile_models, load_robot

EXAMPLES = Path(__file__).parents[2] / "examples"

MODEL = """<mujoco model="hopper">
  <option timestep="0.002"/>
  <default><joint damping="0.2" armature="0.01"/><geom size="0.03" density="500" contype="0"/></default>
  <worldbody>
    <geom type="plane" size="0 0 1" contype="1"/>
    <body name="trunk" pos="0 0 0.6"><freejoint name="root"/><geom type="box" size="0.1 0.1 0.05"/>
      <body name="thigh"><joint name="hip" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.25"/>
        <body name="shank" pos="0 0 -0.25"><joint name="knee" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.25"/><site name="toe" pos="0 0 -0.25"/></body></body></body>
  </worldbody>
  <actuator>
    <position name="hip" joint="hip" kp="30" kv="1" ctrlrange="-1 1"/>
    <position name="knee" joint="knee" kp="30" kv="1" ctrlrange="-1 1"/>
  </actuator>
  <keyframe><key name="crouch" qpos="0 0 0.55 1 0 0 0 0.4 -0.8" qvel="0.1 0 0 0 0 0 0 0" ctrl="0.4 -0.8"/></keyframe>
</mujoco>
"""

ROBOT = """
model = "robot.xml"
duration = 0.2
keyframe = "crouch"
[[parameter]]
name = "damping"
path = ["joint:hip/damping", "joint:knee/damping"]
bounds = [0.0, 2.0]
unit = "N m s/rad"
[[parameter]]
name = "load"
path = "body:trunk/mass"
bounds = [0.5, 2.0]
relative = true
[controller]
signal = "sinusoid"
frequency = [1.0, 3.0]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.xml").write_text(MODEL)
    (tmp_path / "robot.toml").write_text(ROBOT)
    return tmp_path


def test_parameters_are_edits_of_the_model(folder: Path) -> None:
    """Against the same numbers set by hand in the compiled model."""
    robot = load_robot(folder / "robot.toml")
    assert robot.simulation_box.names == ("damping", "load")
    assert robot.simulation_box.units == ("N m s/rad", "")
    assert robot.nominal == (pytest.approx(0.2), 1.0)
    models = compile_models(robot, [[0.7, 1.5], [0.2, 1.0]])
    by_hand = mujoco.MjModel.from_xml_string(MODEL)
    trunk = by_hand.body("trunk").id
    by_hand.dof_damping[6:] = 0.7
    by_hand.body_mass[trunk] *= 1.5
    by_hand.body_inertia[trunk] *= 1.5
    mujoco.mj_setConst(by_hand, mujoco.MjData(by_hand))
    for name in ("dof_damping", "body_mass", "body_inertia", "dof_invweight0", "body_subtreemass", "dof_M0"):
        np.testing.assert_allclose(getattr(models.row(0), name), getattr(by_hand, name), rtol=1e-12)
        np.testing.assert_allclose(getattr(models.row(1), name), getattr(base_model(robot), name), rtol=1e-12)


@pytest.mark.parametrize("engine", ["lanes", "mjx", "native"])
def test_trials_start_in_the_keyframe(folder: Path, engine: str) -> None:
    """Against a loop of mj_step from the keyframe."""
    robot = load_robot(folder)
    simulation, controller = np.array([0.5, 1.2]), robot.controller_box.sample(np.random.default_rng(0))
    found = btr.evaluate(robot, simulation, controller, engine=engine, times=[0.05], states=True).outcome
    model = compile_models(robot, simulation).row(0)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for k in range(25):
        data.ctrl[:] = robot.signal(controller[:, None], k * 0.002, np)[:, 0]
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(found.qpos[0, 0, 0], data.qpos, atol=2e-5)
    np.testing.assert_allclose(found.start[0, 0], [0, 0, 0.55])


def test_ranges_follow_from_the_actuators(folder: Path) -> None:
    robot = load_robot(folder)
    names = ("frequency", "amplitude hip", "phase hip", "amplitude knee", "phase knee")
    assert robot.controller_box.names == names
    np.testing.assert_allclose(robot.controller_box.high[[1, 3]], [0.6, 0.2])  # from 0.4 to 1, from -0.8 to -1
    controller = np.array([2.0, 0.3, 0.5, 0.1, 1.0])
    expected = [0.4 + 0.3 * np.sin(4 * np.pi * 0.1 + 0.5), -0.8 + 0.1 * np.sin(4 * np.pi * 0.1 + 1.0)]
    np.testing.assert_allclose(robot.signal(controller[:, None], 0.1, np)[:, 0], expected)


def test_motors_of_a_group_share_their_parameters(folder: Path) -> None:
    group = '[[controller.group]]\nname = "leg"\nmotors = ["knee", "hip"]\nsign = [1, -1]\nshift = [0.0, 1.5]\n'
    (folder / "robot.toml").write_text(ROBOT.replace("[1.0, 3.0]", "2.0") + "offset = [-0.1, 0.1]\n" + group)
    robot = load_robot(folder)
    assert robot.controller_box.names == ("amplitude leg", "phase leg", "offset leg")
    found = robot.signal(np.array([0.1, 0.2, 0.05])[:, None], 0.1, np)[:, 0]
    wave = lambda shift: 0.05 + 0.1 * np.sin(4 * np.pi * 0.1 + 0.2 + shift)  # noqa: E731
    np.testing.assert_allclose(found, [0.4 - wave(1.5), -0.8 + wave(0.0)])


def test_a_spline_passes_its_knots(folder: Path) -> None:
    (folder / "robot.toml").write_text(ROBOT.replace('"sinusoid"\nfrequency = [1.0, 3.0]', '"spline"\nknots = 4'))
    robot = load_robot(folder)
    knots = robot.controller_box.sample(np.random.default_rng(1))
    for k in range(4):
        found = robot.signal(knots[:, None], 0.2 * k / 3, np)[:, 0]
        np.testing.assert_allclose(found, [0.4 + knots[k], -0.8 + knots[4 + k]], atol=1e-12)
    line = np.concatenate([np.linspace(-0.1, 0.1, 4)] * 2)
    np.testing.assert_allclose(robot.signal(line[:, None], 0.13, np)[0, 0], 0.4 - 0.1 + 0.2 * 0.13 / 0.2)


def test_a_signal_and_a_fitness_of_ones_own(folder: Path) -> None:
    (folder / "mine.py").write_text(
        "def wave(c, t, xp):\n    return xp.stack([c[0] * xp.sin(9.0 * t), c[1] + 0.0 * c[0]])\n"
        "def height(outcome):\n    return outcome.qpos[..., -1, 2]\n"
    )
    rows = "".join(f'[[controller.parameter]]\nname = "{n}"\nbounds = [0.0, 0.5]\n' for n in "ab")
    text = ROBOT.replace('"sinusoid"\nfrequency = [1.0, 3.0]\n', '"mine.py:wave"\n') + rows
    (folder / "robot.toml").write_text('fitness = "mine.py:height"\n' + text)
    robot = load_robot(folder)
    fitness = fitness_function(robot.fitness)
    found = btr.evaluate(robot, robot.nominal, [0.2, 0.1], engine="native", fitness=fitness)
    assert found.outcome.qpos is not None
    assert found.fitness[0, 0] == found.outcome.qpos[0, 0, -1, 2]


def test_the_hand_of_an_arm_is_followed() -> None:
    """Against forward kinematics of the recorded configuration."""
    robot = load_robot(EXAMPLES / "thrower")
    controller = robot.controller_box.sample(np.random.default_rng(0))
    fitness = fitness_of(robot)
    found = btr.evaluate(robot, robot.nominal, controller, fitness=fitness, engine="native")
    model = base_model(robot)
    data = mujoco.MjData(model)
    data.qpos[:] = found.outcome.qpos[0, 0, -1]
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(found.outcome.position[0, 0, -1], data.site("hand").xpos)
    assert found.fitness[0, 0] == pytest.approx(np.linalg.norm(data.site("hand").xpos - robot.target))


def test_a_template_with_includes_and_paths(folder: Path) -> None:
    (folder / "part.xml").write_text('<mujoco><option timestep="0.001"/></mujoco>')
    text = MODEL.replace("0 0 0 0 0 -0.25", "0 0 0 0 0 {{ -leg }}", 1)
    (folder / "robot.xml.j2").write_text(text.replace("<default>", '<include file="part.xml"/><default>', 1))
    row = '[[parameter]]\nname = "leg"\nbounds = [0.2, 0.3]\nnominal = 0.25\n[controller]'
    (folder / "robot.toml").write_text(ROBOT.replace('"robot.xml"', '"robot.xml.j2"').replace("[controller]", row))
    robot = load_robot(folder)
    assert robot.simulation_box.names == ("damping", "load", "leg")
    model = compile_models(robot, [0.5, 1.0, 0.3]).row(0)
    assert model.opt.timestep == 0.001
    assert model.geom_size[2, 1] == pytest.approx(0.15)
    assert model.dof_damping[7] == 0.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("duration", "durration"), "unknown key 'durration'; nearest: 'duration'"),
        (("[0.0, 2.0]", "[2.0, 0.0]"), "expected LOW below HIGH"),
        (("joint:hip", "joint:hipp"), "the model has no joint 'hipp'; nearest: 'hip'"),
        (('"crouch"', '"crotch"'), "keyframe 'crotch': the model has 'crouch'"),
        (("relative = true", "relatve = true"), "unknown key 'relatve'; did you mean 'relative'"),
        (("0.2\nkey", "-0.2\nkey"), "duration: got -0.2"),
        (("[1.0, 3.0]", "0.0"), "frequency = 0.0"),
        (('"sinusoid"', '"sinus"'), "signal = 'sinus'"),
        (('"robot.xml"', '"other.xml"'), "other.xml"),
        (("duration = 0.2", 'base_body = "shank"'), "write point = 'shank' instead; bodies with a free joint: trunk"),
        (("duration = 0.2", 'base_body = "trnk"'), "expected a body with a free joint; nearest: 'trunk'"),
        (("duration", "durration"), "valid keys: name, model, base_body, point, duration, keyframe"),
        (
            ('unit = "N m s/rad"', 'colour = "red"'),
            "valid keys: name, path, bounds, low, high, relative, unit, nominal",
        ),
        (("joint:hip/damping", "geom:geom1/fromto[5]"), "is a variable of a template (docs/robot_file.md)"),
        (("duration = 0.2", 'fitness = "target_distance"\ntarget = [1]'), "expected [x, y, z] in metres"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(folder: Path, change: tuple[str, str], message: str) -> None:
    (folder / "robot.toml").write_text(ROBOT.replace(*change, 1))
    with pytest.raises(InputError) as error:
        load_robot(folder)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_model_is_no_robot_file(folder: Path) -> None:
    with pytest.raises(InputError, match=r"a robot is a robot\.toml, which names its MJCF"):
        load_robot(folder / "robot.xml")


def test_a_robot_that_is_bolted_down_needs_a_point(tmp_path: Path) -> None:
    for name in ("robot.xml", "robot.toml"):
        (tmp_path / name).write_text((EXAMPLES / "thrower" / name).read_text().replace('point = "hand"\n', ""))
    with pytest.raises(InputError, match="neither base_body nor point"):
        load_robot(tmp_path)


def test_a_model_that_blows_up_is_refused(folder: Path) -> None:
    (folder / "robot.xml").write_text(MODEL.replace('kp="30"', 'kp="3e7"'))
    with pytest.raises(InputError, match="becomes unstable within"):
        load_robot(folder)


def test_a_signal_with_a_wrong_number_of_outputs_is_refused(folder: Path) -> None:
    (folder / "mine.py").write_text("def wave(c, t, xp):\n    return c[:1]\n")
    text = ROBOT.replace('"sinusoid"\nfrequency = [1.0, 3.0]\n', '"mine.py:wave"\n')
    (folder / "robot.toml").write_text(text + '[[controller.parameter]]\nname = "a"\nbounds = [0.0, 0.5]\n')
    with pytest.raises(InputError, match=r"gave shape \(1, 2\), expected finite numbers \(2, 2\)"):
        load_robot(folder)


def test_a_parameter_that_changes_nothing_is_refused(folder: Path) -> None:
    text = ROBOT.split("[[parameter]]")
    only = '[[parameter]]\nname = "leg"\nbounds = [0.2, 0.3]\n'
    (folder / "robot.xml.j2").write_text(MODEL)
    (folder / "robot.toml").write_text(
        text[0].replace("robot.xml", "robot.xml.j2") + only + "[controller]" + text[2].split("[controller]")[1]
    )
    with pytest.raises(InputError, match="the model is the same for all of leg"):
        compile_models(load_robot(folder), [0.25])


def test_the_template_of_the_docs_is_a_robot(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs/robot_file.md").read_text(encoding="utf-8")
    part = text.split("## Unknown lengths: a template")[1].split("\n## ")[0]
    leg, table = part.split("```xml\n")[1].split("```")[0], part.split("```toml\n")[1].split("```")[0]
    (tmp_path / "robot.xml.j2").write_text(
        '<mujoco><worldbody><body name="trunk" pos="0 0 1"><joint type="slide" axis="1 0 0"/><geom size="0.1"/></body>'
        f'{leg}</worldbody><actuator><position joint="hip"/><position joint="knee"/></actuator></mujoco>'
    )
    rest = '[controller]\nsignal = "sinusoid"\nfrequency = 1.0\namplitude = [0.0, 0.3]\n'
    (tmp_path / "robot.toml").write_text('point = "trunk"\n' + table + rest)
    robot = load_robot(tmp_path)
    assert robot.simulation_box.names == ("thigh", "trunk mass")
    models = compile_models(robot, [[0.31, 3.6]])
    found = mujoco.MjModel.from_xml_string(robot.render([0.31, 3.6]))
    np.testing.assert_allclose(found.body("shin").pos, [0, 0, -0.31])
    assert models is not None
