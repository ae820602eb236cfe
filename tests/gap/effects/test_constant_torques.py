"""Offsets of drives and gravity compensation against explicit simulations: applied torques, and MJCF attributes."""

import mujoco
import numpy as np
import pytest
from gap_arm import XML, arm
from gap_models import QUADRUPED, check_loop, load, one, windows

from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.simulate import World, simulate


@pytest.mark.parametrize("joint", ["knee0", "hip1", "knee1"])
def test_an_offset_is_a_constant_torque_at_the_joint(joint):
    """Servos, and a motor behind a gear of 5: the number is that of the joint, not of the motor."""
    model = load("quadruped")
    dof = model.joint(joint).dofadr[0]

    def push(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.qfrc_applied[dof] = 0.7

    check_loop(model, one(model, f"offset_torque@joint:{joint}"), [0.7], push)


def test_offsets_of_groups_act_at_every_joint():
    model = load("quadruped")
    dofs = [model.joint(name).dofadr[0] for name in ("hip1", "knee1")]

    def both(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.qfrc_applied[dofs] = -0.4

    check_loop(model, one(model, "offset_torque@subtree:thigh1"), [-0.4], both)

    def own(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.qfrc_applied[dofs] = -0.4, 0.9

    check_loop(model, one(model, "offset_torque@each:subtree:thigh1"), [-0.4, 0.9], own)


def test_a_joint_with_two_motors_has_one_offset():
    """A second motor at the same joint does not double it."""
    second = '<motor name="other" joint="knee1" gear="3"/></actuator>'
    model = mujoco.MjModel.from_xml_string(QUADRUPED.replace("</actuator>", second))
    dof = model.joint("knee1").dofadr[0]

    def push(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.qfrc_applied[dof] = 0.6

    check_loop(model, one(model, "offset_torque@joint:knee1"), [0.6], push)


def test_joints_without_a_drive_have_no_offset():
    model = mujoco.MjModel.from_xml_string(QUADRUPED.replace('<position name="knee1" joint="knee1"/>', ""))
    found = {c.name for c in candidates(model, Scales.of(model), EFFECTS)}
    assert "offset_torque@joint:knee0" in found
    assert "offset_torque@joint:knee1" not in found


@pytest.mark.parametrize("fraction", [0.02, 0.4, 1.0])
def test_gravity_compensation_is_that_of_the_file(fraction):
    expected = mujoco.MjModel.from_xml_string(
        XML.replace('<body name="upper"', f'<body name="upper" gravcomp="{fraction}"').replace(
            '<body name="lower"', f'<body name="lower" gravcomp="{fraction}"'
        )
    )
    model = arm()
    world = one(model, "gravity_compensation@world").apply(World.of(model), [fraction])
    segments = windows(model)
    found, plain, by_file = simulate([(w, segments) for w in (world, World.of(model), World.of(expected))])
    np.testing.assert_allclose(found, by_file, rtol=0, atol=1e-12)
    assert np.abs(found - plain).max() > 1e-3


def test_gravity_compensation_holds_up_this_part_of_the_weight():
    """Torques of half the weight of each link, taken from the model's own gravity at rest."""
    model = arm()
    at_rest, weightless = arm(), arm()
    weightless.opt.gravity[:] = 0

    def held(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        torques = []
        for own in (at_rest, weightless):
            other = mujoco.MjData(own)
            other.qpos[:] = data.qpos
            mujoco.mj_inverse(own, other)
            torques.append(other.qfrc_inverse.copy())
        data.qfrc_applied[:] = 0.5 * (torques[0] - torques[1])

    segments = windows(model)
    world = one(model, "gravity_compensation@world").apply(World.of(model), [0.5])
    found = simulate([(world, segments)])[0]
    for row in range(len(segments)):
        data, own = mujoco.MjData(model), arm()
        data.qpos[:], data.qvel[:] = segments.qpos[row], segments.qvel[row]
        for k in range(30):
            data.ctrl[:] = segments.commands[0].at(segments.start[row] + k * own.opt.timestep)
            held(own, data, 0.0)
            mujoco.mj_step(own, data)
        np.testing.assert_allclose(found[row, -1], [*data.qpos, *data.qvel], rtol=0, atol=1e-6)


def test_every_fraction_that_is_searched_has_an_effect():
    """A model that compensates nothing can compensate more only; one that does may also compensate less."""
    half = mujoco.MjModel.from_xml_string(
        XML.replace('<body name="upper"', '<body name="upper" gravcomp="0.5"').replace(
            '<body name="lower"', '<body name="lower" gravcomp="0.5"'
        )
    )
    for model, low in ((arm(), 0.0), (half, -0.5)):
        candidate = one(model, "gravity_compensation@world")
        (own,) = candidate.parameters
        assert own.low == low
        segments = windows(model)
        worlds = [candidate.apply(World.of(model), [value]) for value in (own.low, 0.5 * own.low, 0.1, own.high)]
        plain, *found = (states[:, -1, 2:] for states in simulate([(w, segments) for w in (World.of(model), *worlds)]))
        moved = [states - plain for states in found]
        if low < 0:
            np.testing.assert_allclose(moved[0], 2 * moved[1], atol=0.1 * np.abs(moved[0]).max())
            assert np.abs(moved[0]).max() > 0.01
        assert np.abs(moved[2]).max() > 1e-3
        np.testing.assert_allclose(moved[3], 15 * moved[2], atol=0.1 * np.abs(moved[3]).max())


def test_robots_that_stand_have_no_gravity_compensation():
    found = {c.effect.name for c in candidates(load("quadruped"), Scales.of(load("quadruped")), EFFECTS)}
    assert "gravity_compensation" not in found
    assert "offset_torque" in found
