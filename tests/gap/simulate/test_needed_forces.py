"""Forces that motions need, against MuJoCo's own inverse dynamics, one state at a time."""

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY, arm
from gap_models import load, one

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.simulate import Command, Rows, Segments, StateLaw, World, needed_forces

COUNT, LENGTH = 7, 5e-3


def pushed(rows: Rows, size: float) -> None:
    rows.qfrc_applied[:, 1] += size * rows.qvel[:, 0]


def random_states(model: mujoco.MjModel) -> tuple[Segments, np.ndarray]:
    """Segments with random states and a held command, and random accelerations."""
    rng = np.random.default_rng(0)
    qpos = np.tile(model.qpos0, (COUNT, 1))
    turns = rng.standard_normal((COUNT, model.nv))
    for row, turn in zip(qpos, turns, strict=True):
        mujoco.mj_integratePos(model, row, turn, 0.3)
    command = Command(np.array([0.0]), rng.uniform(-0.3, 0.3, (1, model.nu)), "hold")
    start, recording = np.zeros(COUNT), np.zeros(COUNT, int)
    qvel, acceleration = (rng.standard_normal((COUNT, model.nv)) for _ in range(2))
    return Segments(start, qpos, qvel, np.zeros(1), (command,), recording), acceleration


def inverse(world: World, states: Segments, acceleration: np.ndarray, applied: np.ndarray) -> np.ndarray:
    """MuJoCo's inverse dynamics without constraints, less what actuators, wrenches and laws give."""
    model = world.update_constants()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, out = mujoco.MjData(model), np.empty_like(acceleration)
    for i in range(COUNT):
        data.qpos[:], data.qvel[:], data.qacc[:] = states.qpos[i], states.qvel[i], acceleration[i]
        data.ctrl[:] = states.commands[0].values[0]
        data.xfrc_applied[:] = world.wrench
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        wrench = np.zeros(model.nv)
        for body in range(model.nbody):
            force, torque = world.wrench[body, :3, None], world.wrench[body, 3:, None]
            mujoco.mj_applyFT(model, data, force, torque, data.xipos[body], body, wrench)
        out[i] = data.qfrc_inverse - data.qfrc_actuator - wrench - applied[i]
    return out


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("armature@joint:elbow", (0.02,)),
        ("actuator_gain@actuator:elbow", (-0.3,)),
        ("payload@body:lower", (0.4, 0.1)),
        ("constant_force@body:lower", (1.5, 0.0, -0.8)),
        ("gravity_compensation@world", (0.5,)),
    ],
)
def test_forces_are_those_of_inverse_dynamics(name: str, values: tuple[float, ...]) -> None:
    model = arm()
    states, acceleration = random_states(model)
    world = World.of(model)
    one(model, name, EFFECTS).apply(world, values)
    world.laws.append(StateLaw(pushed, (0.7,)))
    jobs = [(World.of(model), states), (world, states)]  # of different models, in one batch where they may be
    found, actuators = needed_forces(jobs, [acceleration] * 2, LENGTH, np.ones(2))[1]
    law = np.stack([np.zeros(COUNT), 0.7 * states.qvel[:, 0]], -1)
    np.testing.assert_allclose(found, inverse(world, states, acceleration, law), atol=1e-9)
    assert np.abs(actuators).max() > 0.1


def test_free_bodies_have_forces_too() -> None:
    model = load("quadruped")
    states, acceleration = random_states(model)
    ((found, _),) = needed_forces([(World.of(model), states)], [acceleration], LENGTH, np.full(model.nv, np.inf))
    expected = inverse(World.of(model), states, acceleration, np.zeros_like(acceleration))
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_dry_friction_is_against_the_motion() -> None:
    model = arm()
    states, acceleration = random_states(model)
    world = World.of(model)
    one(model, "dry_friction@joint:elbow", LIBRARY).apply(world, (0.2,))
    jobs = [(w, states) for w in (World.of(model), world)]
    (without, _), (found, _) = needed_forces(jobs, [acceleration] * 2, LENGTH, np.full(2, 1e-9))
    expected = np.stack([np.zeros(COUNT), 0.2 * np.sign(states.qvel[:, 1])], -1)
    np.testing.assert_allclose(found - without, expected, atol=1e-9)
