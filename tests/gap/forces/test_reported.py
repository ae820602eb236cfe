"""Forces that drives report, against plain MuJoCo, and what they tell."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_arm import arm
from gap_forces import arm_dataset, believed, exact_stretch, moved_arm
from gap_models import one

from btr_mjx.gap.effects import TORQUE_CONSTANT
from btr_mjx.gap.effects.actuators import ACTUATOR_GAIN
from btr_mjx.gap.effects.friction import VISCOUS_DAMPING
from btr_mjx.gap.forces import identify_forces, prepare_forces
from btr_mjx.gap.forces.motion import FreeNumber, linearise_motion, pushes
from btr_mjx.gap.forces.stretches import Stretches
from btr_mjx.gap.simulate import Counter

SAMPLES = (3, 18, 31, 47)


def force_at(stretches: Stretches, k: int, shift: np.ndarray | float = 0.0) -> np.ndarray:
    """(2,) forces of the believed drives at a sample, near its state."""
    model = arm()
    data = mujoco.MjData(model)
    state = np.concatenate([stretches.qpos[0, k], stretches.qvel[0, k]]) + shift
    data.qpos[:], data.qvel[:] = state[:2], state[2:]
    data.ctrl[:] = stretches.data.commands[0].at(stretches.time[0, k])
    mujoco.mj_forward(model, data)
    return data.actuator_force.copy()


@pytest.fixture(scope="module")
def stretches() -> Stretches:
    """One stretch of exact states, whose drives report 0.1 more than they have."""
    recording = moved_arm("r", 2, noise=0.0, seconds=0.5, step=2e-5)
    names = [arm().actuator(i).name for i in range(2)]
    empty = {name: np.zeros(len(recording.time)) for name in names}
    found = exact_stretch(replace(recording, force=empty), 20, 60, (0, 1))
    forces = np.stack([force_at(found, k) for k in range(61)])
    return replace(found, reported=forces[None] + 0.1)


def test_what_differs_from_the_report_follows_from_the_state(stretches: Stretches) -> None:
    """The rows of forces say what those of the state do, through the drives' gains."""
    linear = linearise_motion(stretches, believed())
    for k in SAMPLES:
        slope = np.stack(
            [(force_at(stretches, k + 1, e) - force_at(stretches, k + 1)) / 1e-4 for e in 1e-4 * np.eye(4)], 1
        )
        np.testing.assert_allclose(linear.slope[0, k], slope, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(linear.transition[0, k, 4:, :4], slope @ linear.transition[0, k, :4, :4], rtol=1e-6)
        np.testing.assert_allclose(linear.force[0, k, 4:], slope @ linear.force[0, k, :4], rtol=1e-6)
        assert not linear.transition[0, k, :, 4:].any()
        np.testing.assert_allclose(linear.defect[0, k, 4:], slope @ linear.defect[0, k, :4] + 0.1, atol=1e-6)


def test_reports_tell_a_weak_motor_from_friction(stretches: Stretches) -> None:
    """A gain changes what a drive reports, friction only how the joint moves, a torque constant the report alone."""
    model, effects = arm(), (VISCOUS_DAMPING, ACTUATOR_GAIN, TORQUE_CONSTANT)
    joint, drive = f"joint:{model.joint(1).name}", f"actuator:{model.actuator(1).name}"
    places = (f"viscous_damping@{joint}", f"actuator_gain@{drive}", f"torque_constant@{drive}")
    damping, gain, constant = (one(model, name, effects) for name in places)
    numbers = [FreeNumber(c, 0, tuple(c.null), 0.01) for c in (damping, gain, constant)]
    linear = linearise_motion(stretches, believed())
    found, slope = linear.responses(pushes(linear, believed(), numbers)), linear.slope
    own = found[0, :, 4:] - np.einsum("kij,kjc->kic", slope[0], found[0, :, :4])
    forces = np.stack([force_at(stretches, k) for k in range(1, 61)])
    np.testing.assert_allclose(own[..., 0], 0, atol=1e-6 * np.abs(forces).max())
    for column in (1, 2):
        np.testing.assert_allclose(own[:, 1, column], forces[:, 1], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(own[:, 0, column], 0, atol=1e-6)
    assert not found[0, :, :4, 2].any()


@pytest.mark.slow
def test_a_weak_motor_and_damping_at_one_joint_are_both_found() -> None:
    """Although drives report four percent more than they have, which is said."""

    def weak_and_damped(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[1] *= 0.8
        model.actuator_biasprm[1] *= 0.8
        model.dof_damping[1] += 0.3

    prepared = prepare_forces(arm_dataset(3, change=weak_and_damped, reports=1.04, seconds=1.6))
    assert prepared is not None
    found = identify_forces(prepared, (VISCOUS_DAMPING, ACTUATOR_GAIN), 3, lambda _: None, Counter())
    numbers = {one.name: next(iter(one.parameters.values())).value for one in found.effects}
    damping, gain = f"viscous_damping@joint:{arm().joint(1).name}", f"actuator_gain@actuator:{arm().actuator(1).name}"
    assert numbers == {damping: pytest.approx(0.3, rel=0.15), gain: pytest.approx(-0.2, abs=0.03)}
    assert any("Drives report" in note for note in found.notes)
