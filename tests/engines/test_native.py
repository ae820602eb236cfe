import dataclasses

import mujoco
import numpy as np
import pytest

from btr_mjx.evaluation import EngineSettings, evaluate
from btr_mjx.robots import Robot


def stepped_alone(robot: Robot, s: np.ndarray, c: np.ndarray, steps: int) -> tuple[mujoco.MjData, float, float]:
    """The slow, obvious route: one model, one mj_step after the other. Returns data, motor work and peak speed."""
    model = mujoco.MjModel.from_xml_string(robot.render(s))
    data = mujoco.MjData(model)
    work = peak = 0.0
    for k in range(steps):
        for motor in range(18):
            data.ctrl[motor] = c[2 * motor] * np.sin(60.0 * (k * 5e-4) + c[2 * motor + 1])
        mujoco.mj_step(model, data)
        work += 5e-4 * np.abs(data.actuator_force * data.actuator_velocity).sum()
        peak = max(peak, float(np.linalg.norm(data.qvel[:3])))
    return data, work, peak


def test_equal_to_a_plain_loop(robot: Robot, rng: np.random.Generator) -> None:
    s, c = robot.simulation_box.sample(rng, 3), robot.controller_box.sample(rng, 2)
    result = evaluate(dataclasses.replace(robot, duration=0.1), s, c, engine="native", states=True, times=[0.04, 0.1])
    for i in range(3):
        for j in range(2):
            data, work, peak = stepped_alone(robot, s[i], c[j], 200)
            np.testing.assert_array_equal(result.outcome.qpos[i, j, -1], data.qpos)
            np.testing.assert_array_equal(result.outcome.qvel[i, j, -1], data.qvel)
            assert result.outcome.energy[i, j, -1] == pytest.approx(work, rel=1e-12)
            assert result.peak_speed[i, j] == pytest.approx(peak, rel=1e-12)
            travelled = np.hypot(*data.qpos[:2])
            assert result.fitness[i, j] == pytest.approx(travelled / 0.1, rel=1e-12)
            middle, _, _ = stepped_alone(robot, s[i], c[j], 80)
            np.testing.assert_array_equal(result.outcome.position[i, j, 0], middle.qpos[:3])


def test_bits_do_not_depend_on_threads_or_blocks(robot: Robot, rng: np.random.Generator) -> None:
    s, c = robot.simulation_box.sample(rng, 7), robot.controller_box.sample(rng, 7)
    results = [
        evaluate(robot, s, c, engine="native", pairwise=True, settings=EngineSettings(threads=threads, chunk=chunk))
        for threads, chunk in ((1, 256), (2, 256), (2, 3))
    ]
    for other in results[1:]:
        np.testing.assert_array_equal(results[0].outcome.position, other.outcome.position)


def test_another_time_step_and_integrator(robot: Robot, rng: np.random.Generator) -> None:
    longer = dataclasses.replace(robot, duration=0.2)
    s, c = robot.simulation_box.sample(rng, 2), robot.controller_box.sample(rng, 2)
    coarse = evaluate(longer, s, c, engine="native")
    fine = evaluate(longer, s, c, engine="native", settings=EngineSettings(timestep=1e-4, integrator="implicit"))
    difference = np.abs(coarse.fitness - fine.fitness)
    assert 0 < difference.max() < 0.05  # another discretisation of the same robot


def test_divergence_is_reported_and_stays_alone(robot: Robot) -> None:
    s = np.tile(robot.nominal_simulation, (2, 1))
    c = np.tile(robot.controller_box.low, (2, 1))
    slow = dataclasses.replace(robot, speed_limit=1e-6)
    assert evaluate(slow, s, c, engine="native").diverged.all()
    assert np.isnan(evaluate(slow, s, c, engine="native").fitness).all()
    unstable = robot.with_constants(kp=-1e9, kv=0.0, ki=0.0)
    result = evaluate(dataclasses.replace(unstable, duration=0.2), s[:1], c[:1], engine="native")
    assert result.diverged.all()
    assert np.isnan(result.fitness).all()
