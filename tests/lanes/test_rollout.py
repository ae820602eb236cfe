"""`lanes.rollout` against `mujoco.rollout`, for models that lanes computes, guards and refuses."""

import logging
from pathlib import Path

import jax
import mujoco
import mujoco.rollout
import numpy as np
import pytest

from btr_mjx import lanes
from btr_mjx.errors import InputError

ARM = """<mujoco><option timestep="0.002"/><worldbody><geom name="floor" type="plane" size="1 1 .1" pos="0 0 -0.45"/>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
  <geom name="upper" type="capsule" fromto="0 0 0 0 0 -0.25" size="0.03" mass="0.5"/>
  <body name="lower" pos="0 0 -0.25"><joint name="elbow" axis="0 1 0" damping="0.05"/>
    <geom name="lower" type="capsule" fromto="0 0 0 0.1 0 -0.2" size="0.02" mass="0.3"/></body></body>
<body name="ball" pos="1 0 -0.3"><freejoint/>
  <geom name="ball" type="ellipsoid" size="0.05 0.05 0.05" mass="0.2"/></body>{extra}</worldbody>
<actuator><motor joint="shoulder" gear="2"/>
<general joint="elbow" dyntype="filter" dynprm="0.02" gainprm="1"/></actuator>
</mujoco>"""
REFUSED = """</worldbody><tendon><spatial name="rope" stiffness="1"><site site="hook"/><site site="eye"/></spatial>
</tendon><worldbody><site name="hook"/><body><site name="eye"/></body>"""
FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


def starts(model: mujoco.MjModel, count: int, rng: np.random.Generator, near: float) -> np.ndarray:
    """States (count, n) at random times; in a part `near` of them the ball lies where the arm swings."""
    found = np.zeros((count, mujoco.mj_stateSize(model, FULL)))
    data = mujoco.MjData(model)
    for i in range(count):
        mujoco.mj_resetData(model, data)
        data.time = rng.uniform(0, 5)
        data.qpos[:2] = rng.uniform(-0.5, 0.5, 2)
        data.qpos[2] = 0.2 if i < near * count else 3
        data.qvel[:] = rng.normal(size=model.nv)
        data.act[:] = rng.normal(size=model.na)
        mujoco.mj_getState(model, data, found[i], FULL)
    return found


def native(model: mujoco.MjModel, states: np.ndarray, controls: np.ndarray) -> np.ndarray:
    return mujoco.rollout.rollout(model, [mujoco.MjData(model)], states, controls)[0]


def test_every_world_has_the_answer_of_mujoco_rollout(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(extra=""))
    model.opt.tolerance = 0
    states, controls = starts(model, 70, rng, near=0.15), rng.uniform(-1, 1, (70, 130, 2))
    expected = native(model, states, controls)
    with jax.enable_x64(True):
        found = lanes.rollout(model, states, controls)
    tripped = found.engine == "native"
    assert found.state.shape == expected.shape
    assert 5 <= tripped.sum() <= 11
    assert tripped[:5].any()
    np.testing.assert_array_equal(found.state[tripped], expected[tripped])
    np.testing.assert_allclose(found.state, expected, rtol=0, atol=1e-8)
    assert found.native_share == tripped.mean()
    assert found.note == ""
    single = lanes.rollout(model, states, controls)
    assert np.abs(single.state - expected).max() < 1e-3
    again = lanes.rollout(model, states[::-1], controls[::-1])
    np.testing.assert_array_equal(again.state[::-1], single.state)


def test_blocks_chunks_and_segments_that_are_not_full(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='hinge' axis='0 1 0'/><geom size='0.1' pos='0 0 1'/></body></worldbody>"
        "<actuator><motor joint='hinge' gear='20'/></actuator></mujoco>"
    )
    worlds, chunk = 16 * jax.device_count() * 3 + 4, 3  # a block, one chunk and a world
    states, controls = rng.normal(size=(worlds, 3)), rng.uniform(-1, 1, (worlds, 230, 1))
    with jax.enable_x64(True):
        found = lanes.rollout(model, states, controls, chunk=chunk)
    np.testing.assert_allclose(found.state, native(model, states, controls), rtol=0, atol=1e-9)


def test_worlds_that_diverge_are_left_to_native(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='hinge' axis='0 1 0'/><geom size='0.1' pos='0 0 1'/></body></worldbody>"
        "<actuator><motor joint='hinge'/></actuator></mujoco>"
    )
    states, controls = rng.normal(size=(4, 3)), rng.uniform(-1, 1, (4, 20, 1))
    controls[2, 5:] = 1e20
    found = lanes.rollout(model, states, controls)
    assert list(found.engine) == ["lanes", "lanes", "native", "lanes"]
    assert np.isfinite(found.state).all()


def test_a_model_without_actuators(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint axis='0 1 0'/><geom size='0.1' pos='0 0 1'/></body></worldbody></mujoco>"
    )
    states = rng.normal(size=(5, 3))
    with jax.enable_x64(True):
        found = lanes.rollout(model, states, steps=30)
    np.testing.assert_allclose(found.state, native(model, states, np.zeros((5, 30, 0))), rtol=0, atol=1e-9)


def test_without_the_guard_the_answer_would_be_wrong(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(extra=""))
    states, controls = starts(model, 8, rng, near=1), np.ones((8, 130, 2))
    expected = native(model, states, controls)
    model.geom_contype[:3], model.geom_conaffinity[:3] = (1, 2, 2), (0, 1, 1)  # the arm no longer meets the ball
    model.geom_contype[3], model.geom_conaffinity[3] = 0, 1
    assert np.abs(native(model, states, controls) - expected).max() > 0.05


def test_mocap_bodies_stay_where_the_model_puts_them(rng: np.random.Generator) -> None:
    goal = (
        '<body mocap="true" pos="0 0.02 -0.35" euler="0 90 0"><geom type="capsule" size="0.03 0.05" condim="1"/></body>'
    )
    model = mujoco.MjModel.from_xml_string(ARM.format(extra=goal))
    model.opt.tolerance = 0
    states, controls = starts(model, 5, rng, near=0), rng.uniform(-1, 1, (5, 200, 2))
    with jax.enable_x64(True):
        found = lanes.rollout(model, states, controls)
    assert set(found.engine) == {"lanes"}
    expected = native(model, states, controls)
    np.testing.assert_allclose(found.state, expected, rtol=0, atol=1e-8)
    model.geom_contype[-1] = model.geom_conaffinity[-1] = 0
    assert np.abs(native(model, states, controls) - expected).max() > 0.05


def test_fields_may_differ_between_worlds(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(extra=""))
    model.opt.tolerance = 0
    states, controls = starts(model, 6, rng, near=0.2), rng.uniform(-1, 1, (1, 1, 2))
    mass = model.body_mass * rng.uniform(0.5, 2, (6, model.nbody))
    with jax.enable_x64(True):
        found = lanes.rollout(model, states, controls, steps=40, varying={"body_mass": mass})
    assert set(found.engine) == {"lanes", "native"}
    for i in range(6):
        model.body_mass[:] = mass[i]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        expected = native(model, states[i : i + 1], np.repeat(controls, 40, 1))
        np.testing.assert_allclose(found.state[i], expected[0], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("extra", "near", "words"),
    [
        (REFUSED, 0.0, "mjWRAP_SITE"),
        ("", 1.0, "worlds that were tried"),
    ],
)
def test_native_computes_everything_where_lanes_does_not_pay(
    extra: str, near: float, words: str, rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    text = ARM.format(extra=extra)
    model = mujoco.MjModel.from_xml_string(text)
    states, controls = starts(model, 6, rng, near), np.ones((6, 100, 2))
    with caplog.at_level(logging.WARNING):
        found = lanes.rollout(text, states, controls)
    assert words in found.note
    assert words in caplog.text
    assert found.native_share == 1
    np.testing.assert_array_equal(found.state, native(model, states, controls))


def test_guards_hand_over_most_worlds_where_the_tried_ones_stay_clear(
    rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    """The bound of a mesh is that of its box: the ball never touches it, but comes near."""
    text = ARM.format(extra='<body pos="1 0 -0.3"><joint/><geom type="mesh" mesh="tip" mass="1"/></body>').replace(
        "<worldbody>",
        '<asset><mesh name="tip" vertex=".2 0 0 -.2 0 0 0 .15 0 0 -.15 0 0 0 .1 0 0 -.1"/></asset><worldbody>',
    )
    model = mujoco.MjModel.from_xml_string(text)
    states, controls = starts(model, 6, rng, 0), np.ones((6, 5, 2))
    states[:, 3:6] = model.body("ball").pos + np.array([0.17, 0.12, 0.08])  # qpos of the ball, beyond the slanted face
    states[:, 1 + model.nq :] = 0
    found = lanes.rollout(text, states, controls)
    assert "guards found possible contacts" in found.note
    np.testing.assert_array_equal(found.state, native(model, states, controls))


def test_coverage_names_what_is_computed_guarded_and_refused(tmp_path: Path) -> None:
    found = lanes.coverage(ARM.format(extra=REFUSED))
    assert found.verdict == "refused"
    assert set(found.computed) == {"upper and floor", "lower and floor", "ball and floor"}
    assert any("(upper and ball)" in line for line in found.guarded)
    assert not any("upper" in line and "lower" in line for line in found.guarded)  # parent and child
    assert [line for line in found.refused if "rope" in line]
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(extra=""))
    assert lanes.coverage(path).verdict == "guarded"
    assert "2 are guarded" in str(lanes.coverage(path))
    free = ARM.format(extra="").replace('name="ball" type', 'name="ball" contype="0" conaffinity="0" type')
    assert lanes.coverage(free).verdict == "computed"
    round_ball = lanes.coverage(ARM.format(extra="").replace("ellipsoid", "sphere"))
    assert round_ball.verdict == "computed"
    assert {"upper and ball", "lower and ball"} < set(round_ball.computed)


def test_the_summary_of_coverage_is_short_and_names_the_nearest_pairs() -> None:
    """Boxes in a row: of many guarded pairs the neighbours come first, by the gaps that were built."""
    gaps = np.array([0.5, 0.02, 0.3, 0.1, *np.full(20, 0.6)])
    places = np.concatenate([[0.0], np.cumsum(gaps + 0.2)])
    boxes = "".join(
        f'<body pos="{x} 0 1"><freejoint/><geom name="box{i}" type="box" size="0.1 0.1 0.1"/></body>'
        for i, x in enumerate(places)
    )
    found = lanes.coverage(f"<mujoco><worldbody>{boxes}</worldbody></mujoco>")
    assert len(found.pairs) == len(places) * (len(places) - 1) / 2
    assert [pair.names for pair in found.pairs[:3]] == ["box1 and box2", "box3 and box4", "box2 and box3"]
    np.testing.assert_allclose([pair.distance for pair in found.pairs[:3]], [0.02, 0.1, 0.3], atol=1e-6)
    lines = str(found).splitlines()
    assert len(lines) <= 20
    assert "300 are guarded" in lines[0]
    assert "box1 and box2, 0.02 m apart" in str(found)


def test_the_example_of_the_docs_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (Path(__file__).parents[2] / "docs/lanes.md").read_text(encoding="utf-8")
    code = text.split("```python\n")[1].split("```")[0]
    assert len(code.split("\n\n")[1].splitlines()) <= 10
    assert code.count("4096, 500") == 2
    (tmp_path / "robot.xml").write_text(ARM.format(extra=""), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(code.replace("(4096, 500", "(20, 30"), names)
    assert names["rolled"].state.shape == (20, 30, 19)
    assert names["rolled"].note == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.zeros((2, 5)), np.zeros((2, 3, 2))), "initial_states"),
        ((np.zeros((2, 19)), np.zeros((2, 3, 4))), "controls"),
        ((np.zeros((2, 19)), np.zeros((3, 3, 2))), "rows"),
        ((np.zeros((2, 19)),), "steps"),
    ],
)
def test_bad_input_is_named(arguments: tuple, words: str) -> None:
    with pytest.raises(InputError, match=words):
        lanes.rollout(ARM.format(extra=""), *arguments)
    with pytest.raises(InputError, match="mass_of_body"):
        lanes.rollout(ARM.format(extra=""), np.zeros((1, 19)), steps=2, varying={"mass_of_body": [[1.0]]})
    with pytest.raises(InputError, match="nothing"):
        lanes.coverage("nothing.xml")


def test_worlds_that_bring_what_is_refused_are_left_to_native(rng: np.random.Generator) -> None:
    """Here friction loss of a free joint."""
    model = mujoco.MjModel.from_xml_string(ARM.format(extra=""))
    losses = np.zeros((3, model.nv))
    losses[1] = 0.1
    states, controls = starts(model, 3, rng, near=0), rng.uniform(-1, 1, (3, 20, 2))
    found = lanes.rollout(model, states, controls, varying={"dof_frictionloss": losses})
    assert "friction loss of a free joint" in found.note
    for i in range(3):
        own = mujoco.MjModel.from_xml_string(ARM.format(extra=""))
        own.dof_frictionloss[:] = losses[i]
        np.testing.assert_array_equal(found.state[i : i + 1], native(own, states[i : i + 1], controls[i : i + 1]))
