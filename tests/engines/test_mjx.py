"""MJX against native MuJoCo stepped one by one, on the same rendered MJCF."""

import dataclasses

import jax
import mujoco
import numpy as np
import pytest
from lanes_models import QUICK

from btr_mjx.engines import MjxStepper, UnsupportedModel
from btr_mjx.evaluation import evaluate
from btr_mjx.models import compile_models
from btr_mjx.robots import Robot


def test_float64_trajectory_equals_native(robot: Robot, rng: np.random.Generator) -> None:
    """40 steps through touchdown for 5 morphologies: positions to 1e-8, the integral state included."""
    steps, s, c = 40, robot.simulation_box.sample(rng, 5), robot.controller_box.sample(rng, 5)
    # Fall the first millimetres quickly, so that contacts happen within the horizon.
    grounded = robot.with_constants(start_clearance=-0.001, ki=2e5)
    models = compile_models(grounded, s)
    with jax.enable_x64(True):
        stepper = MjxStepper(models.base, frozenset(models.leaves))
        params = jax.tree.map(
            lambda x: x[0], stepper.pack({name: values[None] for name, values in models.leaves.items()})
        )
        step = jax.jit(lambda params, state, ctrl: stepper.step(params, state, ctrl), compiler_options=QUICK)
        state, trace, capped = stepper.initial(params, 5), [], []
        for k in range(steps):
            state = step(params, state, grounded.signal(c.T, k * 5e-4, np))
            trace.append(np.array(stepper.qpos(state)).T)
            capped.append(np.array(stepper.capped(state)))
        velocity = np.array(stepper.qvel(state)).T
    contacts = 0
    for i in range(5):
        model = mujoco.MjModel.from_xml_string(grounded.render(s[i]))
        data = mujoco.MjData(model)
        for k in range(steps):
            data.ctrl[:] = grounded.signal(c[i], k * 5e-4, np)
            mujoco.mj_step(model, data)
            contacts += data.ncon
            np.testing.assert_allclose(trace[k][i], data.qpos, rtol=0, atol=1e-8)
        np.testing.assert_allclose(velocity[i], data.qvel, rtol=0, atol=1e-5)
    assert contacts > 50
    assert not np.any(capped)


@pytest.fixture(scope="module")
def float32(robot: Robot):
    rng = np.random.default_rng(3)
    s, c = robot.simulation_box.sample(rng, 5), robot.controller_box.sample(rng, 13)
    return s, c, evaluate(robot, s, c, engine="mjx", states=True)


def test_float32_is_close_to_native(robot: Robot, float32) -> None:
    s, c, result = float32
    exact = evaluate(robot, s, c, engine="native", states=True)
    np.testing.assert_allclose(result.outcome.qpos, exact.outcome.qpos, rtol=0, atol=2e-5)
    np.testing.assert_allclose(result.fitness, exact.fitness, rtol=0, atol=1e-3)
    np.testing.assert_allclose(result.outcome.energy, exact.outcome.energy, rtol=1e-3)
    np.testing.assert_allclose(result.peak_speed, exact.peak_speed, rtol=1e-3, atol=1e-4)
    assert result.solver_capped.sum() == 0


def test_position_in_the_batch_does_not_change_a_bit(robot: Robot, float32) -> None:
    s, c, result = float32
    rng = np.random.default_rng(8)
    rows, columns = rng.integers(0, 5, 70), rng.integers(0, 13, 70)
    other = evaluate(robot, s[rows], c[columns], engine="mjx", pairwise=True, states=True)
    np.testing.assert_array_equal(other.outcome.qpos, result.outcome.qpos[rows, columns])
    np.testing.assert_array_equal(other.fitness, result.fitness[rows, columns])


def test_what_mjx_would_ignore_is_refused() -> None:
    def model(body: str = "", actuator: str = "") -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(
            f"<mujoco><worldbody><body><joint name='j' {body}/><geom size='.1'/></body></worldbody>"
            f"<actuator>{actuator}</actuator></mujoco>"
        )

    with pytest.raises(UnsupportedModel, match="actuator_delay"):
        MjxStepper(model(actuator="<motor joint='j' delay='0.01' nsample='20'/>"), frozenset())
    with pytest.raises(UnsupportedModel, match="imax"):
        MjxStepper(model(actuator="<pid joint='j' kp='1' ki='1' imax='2' input='pos'/>"), frozenset())
    with pytest.raises(UnsupportedModel, match="actuator_ctrlnum"):
        MjxStepper(model(actuator="<pid joint='j' kp='1' kv='1'/>"), frozenset())


def test_gains_of_pid_cannot_vary(robot: Robot) -> None:
    models = compile_models(robot, [robot.nominal])
    stepper = MjxStepper(models.base, frozenset({"actuator_gainprm"}))
    with pytest.raises(UnsupportedModel, match="pid"):
        stepper.pack({"actuator_gainprm": np.zeros((1, 1, 18, 10))})


def test_duration_is_no_part_of_the_program(robot: Robot) -> None:
    """The horizon is an argument: another one must give the same states at the same times."""
    c = robot.controller_box.sample(np.random.default_rng(1), 2)
    longer = dataclasses.replace(robot, duration=0.05)
    a = evaluate(robot, [robot.nominal], c, engine="mjx", states=True)
    b = evaluate(longer, [robot.nominal], c, engine="mjx", states=True, times=[0.03])
    np.testing.assert_array_equal(a.outcome.qpos, b.outcome.qpos)
