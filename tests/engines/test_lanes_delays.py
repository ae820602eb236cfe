"""Delayed controls of the lanes engine, against native MuJoCo's history buffers."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lanes_models import QUICK, chain, mjcf

from btr_mjx.engines import LanesStepper
from btr_mjx.engines.lanes_engine.delays import CUBIC, HOLD, LINEAR, delayed

STEPS, WORLDS = 25, 4
ACTUATORS = """<motor joint="p0" gear="3" delay="0.0033" nsample="4"/>
<position joint="p1" kp="20" kv="0.5" ctrlrange="-0.4 0.4" delay="0.0051" nsample="5" interp="linear"/>
<general joint="p2" dyntype="filter" dynprm="0.01" gainprm="3" delay="0.0047" nsample="6" interp="cubic"/>
<motor joint="p3" delay="0.006" nsample="3"/><motor joint="p4" nsample="3"/>"""


def native(model: mujoco.MjModel, controls: np.ndarray) -> np.ndarray:
    """qpos after every step (T, nq) of controls (T, nu)."""
    data, found = mujoco.MjData(model), []
    for ctrl in controls:
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    return np.array(found)


def lanes(stepper: LanesStepper, params: dict, controls: np.ndarray) -> np.ndarray:
    """The same of controls (T, nu, C): (T, nq, C)."""

    def step(state, ctrl):
        state = stepper.step(params, state, ctrl)
        return state, stepper.qpos(state)

    run = jax.jit(lambda u: jax.lax.scan(step, stepper.initial(params, u.shape[-1]), u)[1], compiler_options=QUICK)
    return np.asarray(run(jnp.asarray(controls)))


def test_delays_equal_native_mujoco(rng: np.random.Generator) -> None:
    """Every interpolation, a delay of the whole buffer and a buffer that is only kept, from the first step on."""
    model = mujoco.MjModel.from_xml_string(mjcf(chain(5), actuators=ACTUATORS))
    controls = rng.uniform(-0.6, 0.6, (STEPS, model.nu, WORLDS))
    with jax.enable_x64(True):
        found = lanes(LanesStepper(model), {}, controls)
    for world in range(WORLDS):
        np.testing.assert_allclose(found[..., world], native(model, controls[..., world]), rtol=0, atol=1e-11)


def test_delays_may_differ_between_worlds(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(chain(5), actuators=ACTUATORS))
    controls = rng.uniform(-0.6, 0.6, (STEPS, model.nu, WORLDS))
    delays = rng.uniform(0.0, 0.013, (WORLDS, model.nu))
    delays[0] = 0.0
    with jax.enable_x64(True):
        stepper = LanesStepper(model, {"actuator_delay": np.ones(model.nu, bool)})
        params = jax.tree.map(lambda x: x[0], stepper.pack({"actuator_delay": delays[None]}))
        found = lanes(stepper, params, controls)
    for world in range(WORLDS):
        model.actuator_delay[:] = delays[world]
        np.testing.assert_allclose(found[..., world], native(model, controls[..., world]), rtol=0, atol=1e-11)


@pytest.mark.parametrize("order", [HOLD, LINEAR, CUBIC])
@settings(deadline=None, max_examples=60)
@given(age=st.floats(-2, 9), samples=st.lists(st.floats(-5, 5), min_size=1, max_size=6))
def test_a_known_age_and_one_per_world_read_the_same(order: int, age: float, samples: list[float]) -> None:
    traced = [jnp.full(2, x, jnp.float32) for x in samples]
    known = delayed(traced, age, order)
    per_world = delayed(traced, jnp.full(2, age, jnp.float32), order)
    if order != HOLD or abs(age - round(age)) > 1e-3:
        np.testing.assert_allclose(known * np.ones(2), per_world, atol=1e-3)
    if order != CUBIC:  # a mean of samples: never beyond them
        assert min(samples) - 1e-4 <= float(per_world[0]) <= max(samples) + 1e-4
    assert delayed([3.0] * len(samples), age, order) == pytest.approx(3.0)
