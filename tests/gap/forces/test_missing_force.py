"""The missing force of recordings against the force that pushed them, and drives against those that were planted."""

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY, arm
from gap_forces import arm_stretches, believed, exact_stretch, moved_arm
from gap_models import one

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.forces.missing_force import MissingForce, drives, missing_force
from btr_mjx.gap.simulate import Segments, simulate


def exact(**how) -> MissingForce:
    recording = moved_arm("r", 3, noise=0.0, seconds=1.2, step=5e-5, **how)
    return missing_force(exact_stretch(recording, 20, 215), believed())


MIDDLES = 0.1 + 0.005 * (np.arange(215) + 0.5)


def test_the_force_that_pushed_is_found():
    def force(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        return np.array([0.4 * np.sin(5 * t), -0.1])

    found = exact(force=force)
    nothing = exact()
    np.testing.assert_allclose(found.force[0, :, 0], 0.4 * np.sin(5 * MIDDLES), atol=0.02)
    np.testing.assert_allclose(found.force[0, :, 1], -0.1, atol=0.01)
    assert np.abs(nothing.force).max() < 0.02
    assert np.abs(nothing.actuator).max() > 1.0


def test_forces_of_actuators_and_motion_are_those_of_the_middle_of_an_interval():
    """The servo is known in closed form: kp (u - q) - kv v."""
    recording = moved_arm("r", 3, noise=0.0, seconds=1.2, step=5e-5)
    own = exact_stretch(recording, 20, 215)
    found = missing_force(own, believed())
    command = own.data.commands[0].at(MIDDLES)
    position, velocity = (0.5 * (x[0, 1:] + x[0, :-1]) for x in (own.qpos, own.qvel))
    np.testing.assert_allclose(found.velocity[0], velocity, atol=1e-9)
    np.testing.assert_allclose(found.acceleration[0], np.diff(own.qvel[0], axis=0) / 0.005, atol=1e-6)
    servo = np.array([20, 10]) * (command - position) - np.array([0.5, 0.2]) * velocity
    np.testing.assert_allclose(found.actuator[0], servo, atol=5e-3)


def test_what_a_hypothesis_knows_is_not_missing():
    def damped(model: mujoco.MjModel) -> None:
        model.dof_damping[1] += 0.1

    recording = moved_arm("r", 3, change=damped, noise=0.0, seconds=1.2, step=5e-5)
    own = exact_stretch(recording, 20, 215)
    damping = one(arm(), "viscous_damping@joint:elbow", LIBRARY)
    knows = missing_force(own, believed().with_effect(damping, [0.1]))
    lacks = missing_force(own, believed())
    assert np.abs(knows.force).max() < 0.02
    np.testing.assert_allclose(lacks.force[..., 1], -0.1 * lacks.velocity[..., 1], atol=0.02)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gravity_compensation@world", (0.5,)),
        ("constant_force@body:lower", (1.5, 0.0, -0.8)),
        ("payload@body:lower", (0.2,)),
        ("joint_offset@joint:elbow", (0.08,)),
        ("offset_torque@joint:shoulder", (0.3,)),
    ],
)
def test_a_hypothesis_that_is_simulated_lacks_nothing(name, value):
    """Of motions of a hypothesis, whatever kind of effect it has, inverse dynamics leaves nothing."""
    plain = exact_stretch(moved_arm("r", 3, noise=0.0, seconds=1.2, step=5e-5), 20, 100)
    effect = one(arm(), name, EFFECTS)
    values = tuple(value[: len(effect.parameters)]) + tuple(effect.null[len(value) :])
    hypothesis = believed().with_effect(effect, values)
    segments = Segments(
        plain.time[:, 0],
        plain.qpos[:, 0],
        plain.qvel[:, 0],
        plain.time - plain.time[:, :1],
        plain.data.commands,
        plain.recording,
    )
    (states,) = simulate([(hypothesis(plain.data.recordings[0].model), segments)], timestep=5e-5)
    own = plain.about(states[..., :2], states[..., 2:])
    # A hypothesis that was not simulated yet, as others may be.
    found = missing_force(own, believed().with_effect(effect, values))
    lacking = missing_force(own, believed())
    assert np.abs(lacking.force[:, 1:]).max() > 0.1
    assert np.abs(found.force[:, 1:]).max() < 0.15 * np.abs(lacking.force[:, 1:]).max()


PLANTED = np.array([[0.2, 0.1], [0.08, 0.04], [0.01, 0.005], [0.15, -0.05]])
"""Dry friction, damping, rotor inertia and an offset, at both joints."""


def missing_drives(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[:] += PLANTED[0]
    model.dof_damping[:] += PLANTED[1]
    model.dof_armature[:] += PLANTED[2]


def test_drives_are_found_again():
    recordings = [
        moved_arm(f"r{i}", i, change=missing_drives, force=lambda q, v, t: PLANTED[3], noise=0.1, seconds=1.5)
        for i in range(3)
    ]
    found = drives(missing_force(arm_stretches(recordings), believed()))
    np.testing.assert_allclose(found[:4], PLANTED, rtol=0.1, atol=0.003)


def test_drives_explain_nothing_where_nothing_is_missing():
    recordings = [moved_arm(f"r{i}", i, noise=0.1, seconds=1.5) for i in range(2)]
    found = drives(missing_force(arm_stretches(recordings), believed()))
    assert (np.abs(found[:4]) < 0.05 * np.abs(PLANTED)).all()


@pytest.mark.parametrize("row", range(4))
def test_each_drive_alone_is_told_from_the_others(row):
    """In a force made of it along a motion; friction, damping and inertia are never negative."""
    motion = exact()
    one_of = [
        -np.sign(motion.velocity),
        -motion.velocity,
        -motion.acceleration,
        np.ones_like(motion.velocity),
    ][row] * PLANTED[row]
    own = MissingForce(one_of, motion.actuator, motion.velocity, motion.acceleration)
    found = drives(own)
    np.testing.assert_allclose(found[row], PLANTED[row], rtol=0.05)
    others = np.delete(found[:4] / PLANTED, row, 0)
    assert np.abs(others).max() < 0.1
    against = drives(MissingForce(-one_of, motion.actuator, motion.velocity, motion.acceleration))
    assert (against[:3] >= 0).all()
