"""Contact forces at the feet against the contacts of MuJoCo's own data, one state at a time."""

import dataclasses

import mujoco
import numpy as np
import pytest
from foot_forces import foot_bodies, foot_forces

from btr_mjx.errors import InputError
from btr_mjx.evaluation import Engine, evaluate
from btr_mjx.models import base_model
from btr_mjx.robots import Robot


@pytest.mark.parametrize("engine", ["native", "lanes"])
def test_forces_are_those_of_the_contacts(robot: Robot, rng: np.random.Generator, engine: Engine) -> None:
    robot = dataclasses.replace(robot, duration=0.15)  # until feet have touched the ground
    s, c = robot.simulation_box.sample(rng, 2), robot.controller_box.sample(rng, 3)
    trials = evaluate(robot, s, c, engine=engine, times=[0.05, 0.1, 0.15], states=True).outcome
    assert trials.qpos is not None
    assert trials.qvel is not None
    assert trials.act is not None
    forces = foot_forces(robot, s, c, trials)
    assert forces.shape == (2, 3, 3, 6)
    assert (forces >= 0).all()
    assert (forces > 1).any()
    for i, simulation in enumerate(s):
        model = mujoco.MjModel.from_xml_string(robot.render(simulation))
        feet = foot_bodies(model)
        for j, controller in enumerate(c):
            for k, time in enumerate(trials.times):
                data = mujoco.MjData(model)
                data.qpos[:], data.qvel[:] = trials.qpos[i, j, k], trials.qvel[i, j, k]
                data.act[:] = trials.act[i, j, k]
                data.ctrl[:] = robot.signal(controller[:, None], time, np)[:, 0]
                mujoco.mj_forward(model, data)
                by_body, found = dict.fromkeys(feet, 0.0), np.zeros(6)
                for number, contact in enumerate(data.contact):
                    mujoco.mj_contactForce(model, data, number, found)
                    for geom in contact.geom:
                        name = model.body(model.geom_bodyid[geom]).name
                        if name in by_body:
                            by_body[name] += found[0]
                np.testing.assert_allclose(forces[i, j, k], list(by_body.values()), rtol=1e-6, atol=1e-6)


def test_activations_are_native_mujoco_s(robot: Robot, rng: np.random.Generator) -> None:
    """The integrals of the motors that lanes and MJX record are those of native MuJoCo, within float32."""
    s, c = robot.simulation_box.sample(rng, 2), robot.controller_box.sample(rng, 2)
    native, lanes, mjx = (
        evaluate(robot, s, c, engine=engine, times=[0.01], states=True).outcome.act
        for engine in ("native", "lanes", "mjx")
    )
    assert native is not None
    assert np.abs(native).max() > 1e-4
    for other in (lanes, mjx):
        np.testing.assert_allclose(other, native, atol=2e-3 * np.abs(native).max())


def test_feet_are_the_ends_of_limbs(robot: Robot) -> None:
    assert set(foot_bodies(base_model(robot))) == {f"b{i}" for i in range(9, 15)}


def test_bad_input(robot: Robot, rng: np.random.Generator) -> None:
    s, c = robot.simulation_box.sample(rng, 1), robot.controller_box.sample(rng, 2)
    trials = evaluate(robot, s, c, engine="native", times=[0.01], states=True).outcome
    with pytest.raises(InputError, match="no states"):
        foot_forces(robot, s, c, dataclasses.replace(trials, act=None))
    with pytest.raises(InputError, match="every simulation with every"):
        foot_forces(robot, s, c[:1], trials)
    with pytest.raises(InputError, match="'b99'"):
        foot_forces(robot, s, c, trials, ["b99"])
    gone = dataclasses.replace(trials, qpos=np.full_like(trials.qpos, np.nan))
    assert np.isnan(foot_forces(robot, s, c, gone)).all()
