"""Contacts that <pair> elements describe, and gravity compensation, against native MuJoCo."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from lanes_models import QUICK

from btr_mjx.engines import LanesStepper, possible_contacts


def compare(model: mujoco.MjModel, states: list[mujoco.MjData]) -> np.ndarray:
    """Errors of the accelerations of one step, relative to the largest; checks that no world is marked."""
    with jax.enable_x64(True):
        stepper = LanesStepper(model, guards=True)
        before = stepper.state(*(np.stack([getattr(d, n) for d in states], axis=1) for n in ("qpos", "qvel")))
        after = jax.jit(stepper.step, compiler_options=QUICK)({}, before, jnp.zeros((model.nu, len(states))))
        found = np.asarray(stepper.qacc(after))
        assert not np.asarray(stepper.tripped(after)).any()
        assert not np.asarray(stepper.capped(after)).any()
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 100, 0
    for data in states:
        mujoco.mj_step(model, data)
    expected = np.stack([d.qacc for d in states], axis=1)
    return np.linalg.norm(found - expected, axis=0) / np.linalg.norm(expected, axis=0).clip(1e-3)


def thrown(model: mujoco.MjModel, count: int, height: float, rng: np.random.Generator) -> list[mujoco.MjData]:
    """States around qpos0 with the first body, a free one, near the planes, turned a little or much."""
    found = []
    for turn in [0.1, 10.0] * (count // 2):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, 0.4 * rng.normal(size=model.nv), 1.0)
        data.qpos[:3] = rng.uniform([0, -1, 0], [height, 1, height])
        data.qpos[3:7] = [1, 0, 0, 0] + turn * rng.normal(size=4)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        data.qvel[:] = rng.normal(size=model.nv)
        found.append(data)
    return found


PAIRS = """<mujoco><option cone="{cone}"/><default><geom contype="0" conaffinity="0" density="300"/></default>
  <worldbody><geom name="floor" type="plane" size="9 9 1"/><body><freejoint/>
    <geom name="trunk" type="box" size=".1 .15 .03"/>
    <body pos=".1 .1 0"><joint axis="0 1 0"/>
      <geom name="left" type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/></body>
    <body pos=".1 -.1 0"><joint axis="0 1 0"/>
      <geom name="right" type="capsule" fromto="0 0 0 0 0 -.2" size=".03"/></body></body></worldbody>
  <contact><pair geom1="left" geom2="right" condim="4" friction="1 1 .02 .001 .001" margin=".3" solref=".03 .8"/>
    <pair geom1="floor" geom2="trunk" condim="6" friction=".4 .4 .02 .003 .003" gap=".02"/>
    <pair geom1="left" geom2="floor" condim="3" solimp=".7 .9 .02 .5 2"/>
    <pair geom1="right" geom2="floor" condim="3" margin=".02"/></contact></mujoco>"""


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_contacts_of_pair_elements_equal_native(cone: str, rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(PAIRS.format(cone=cone))
    states = thrown(model, 100, 0.2, rng)
    assert compare(model, states).max() < 1e-10
    touching = {tuple(sorted(pair)) for d in states for pair in d.contact.geom.tolist()}
    assert touching == {(0, 1), (0, 2), (0, 3), (2, 3)}


@pytest.mark.parametrize(
    "change",
    [
        ('friction="1 1 .02 .001 .001"', 'friction="1 .5 .02 .001 .001"'),
        ('friction="1 1 .02 .001 .001"', 'solreffriction=".05 1"'),
        ('<pair geom1="floor"', '<pair geom1="trunk" geom2="floor"/><pair geom1="floor"'),
    ],
)
def test_pair_elements_that_are_not_computed_are_guarded(change: tuple[str, str]) -> None:
    model = mujoco.MjModel.from_xml_string(PAIRS.format(cone="pyramidal").replace(*change))
    assert possible_contacts(model).guarded


@pytest.mark.parametrize("flag", ["", '<flag spring="disable" damper="disable"/>', '<flag gravity="disable"/>'])
def test_gravity_compensation_equals_native(flag: str, rng: np.random.Generator) -> None:
    text = f"""<mujoco><option gravity="1 2 -9">{flag}</option><worldbody><body gravcomp="0.5"><freejoint/>
        <geom type="box" size=".1 .2 .3"/><body pos=".2 0 0"><joint axis="0 1 1"/><geom size=".1" pos=".1 0 0"/>
        <body pos="0 .3 .1" euler="20 30 0" gravcomp="1.5"><geom size=".1" pos=".2 0 .1"/></body></body></body>
        </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    model.geom_contype[:] = 0
    assert compare(model, thrown(model, 50, 1.0, rng)).max() < 1e-10
