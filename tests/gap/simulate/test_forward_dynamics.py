"""Accelerations of many worlds at once, against MuJoCo one state at a time."""

import mujoco
import numpy as np
import pytest
from gap_arm import arm
from gap_models import one

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.simulate import Command, Counter, Rows, Segments, StateLaw, World, accelerations

COUNT, LENGTH = 7, 5e-3


FILTERED = """<mujoco><worldbody><body><joint name="j" axis="0 1 0" damping="0.1"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3" mass="0.5"/></body></worldbody>
    <actuator><general joint="j" dyntype="filter" dynprm="0.02" gainprm="2"/></actuator></mujoco>"""
"""A joint whose motor's force follows its command with a time constant of 20 ms."""


def pushed(rows: Rows, size: float) -> None:
    rows.qfrc_applied[:, 1] += size * rows.qvel[:, 0]


def states_of(model: mujoco.MjModel, interpolation: str) -> Segments:
    """Random states at random times of a command that changes within the time over which it is averaged."""
    rng = np.random.default_rng(0)
    qpos = model.qpos0 + 0.3 * rng.standard_normal((COUNT, model.nq))
    command = Command(np.arange(0, 0.1, 3e-3), rng.uniform(-0.3, 0.3, (34, model.nu)), interpolation)
    act = rng.standard_normal((COUNT, model.na)) if model.na else None
    recording, start = np.zeros(COUNT, int), rng.uniform(0, 0.05, COUNT)
    return Segments(start, qpos, rng.standard_normal((COUNT, model.nv)), np.zeros(1), (command,), recording, act)


def expected(world: World, states: Segments, applied: np.ndarray) -> np.ndarray:
    """MuJoCo's forward dynamics with the mean of a held command, and else with its value in the middle."""
    model, out = world.update_constants(), np.empty_like(states.qvel)
    data = mujoco.MjData(model)
    command = world.command(states.commands[0])
    fine = LENGTH * (np.arange(5000) + 0.5) / 5000
    for i in range(COUNT):
        values, middle = command.at(states.start[i] + fine), command.at(states.start[i] + 0.5 * LENGTH)
        data.qpos[:], data.qvel[:] = states.qpos[i], states.qvel[i]
        data.ctrl[:] = values.mean(0) if command.interpolation == "hold" else middle
        data.qfrc_applied[:] = applied[i]
        if states.act is not None:  # the exact response of the filter to the command in the middle
            data.act[:] = middle + (states.act[i] - middle) * np.exp(-0.5 * LENGTH / model.actuator_dynprm[:, 0])
        mujoco.mj_forward(model, data)
        out[i] = data.qacc
    return out


@pytest.mark.parametrize("interpolation", ["hold", "linear", "cubic"])
def test_accelerations_are_those_of_the_models_own_forward_dynamics(interpolation: str) -> None:
    """Of worlds with another inertia, another command and a law, together."""
    model, believed = arm(), World.of(arm())
    states = states_of(model, interpolation)
    heavy, late, law = (World.of(model) for _ in range(3))
    one(model, "payload@body:lower", EFFECTS).apply(heavy, np.array([0.4, 0.1]))
    one(model, "actuator_delay@all", EFFECTS).apply(late, np.array([0.004]))
    law.laws.append(StateLaw(pushed, (0.7,)))
    counter = Counter()
    found = accelerations([(world, states) for world in (believed, heavy, late, law)], LENGTH, counter)
    nothing = np.zeros_like(states.qvel)
    pushes = np.stack([nothing[:, 0], 0.7 * states.qvel[:, 0]], -1)
    for own, world, applied in zip(found, (believed, heavy, late, law), (*3 * [nothing], pushes), strict=True):
        np.testing.assert_allclose(own, expected(world, states, applied), rtol=1e-3, atol=2e-2)
    for own in found[1:]:
        assert np.abs(own - found[0]).max() > 0.1
    assert counter.steps == 4 * COUNT


def test_filters_of_actuators_are_those_in_the_middle() -> None:
    slow = mujoco.MjModel.from_xml_string(FILTERED)
    states = states_of(slow, "linear")
    (found,) = accelerations([(World.of(slow), states)], LENGTH)
    exact = expected(World.of(slow), states, np.zeros_like(states.qvel))
    np.testing.assert_allclose(found, exact, rtol=0.01, atol=0.01 * np.abs(exact).max())
    start = expected(World.of(slow), Segments(**{**vars(states), "act": states.act + 1.0}), np.zeros_like(states.qvel))
    assert np.abs(start - exact).max() > 0.1
