"""An arm whose motors are given torques that are held between samples, as a digital controller does it."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench, identify
from btr_mjx.gap.simulate import Command
from btr_mjx.gap.windows import Options, signatures

XML = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom density="800" contype="0" conaffinity="0"/><joint damping="0.15"/></default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.025"/>
      <body name="fore" pos="0 0 -0.25">
        <joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.22" size="0.02"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="ms" joint="shoulder"/><motor name="me" joint="elbow"/></actuator>
</mujoco>
"""
INTERVAL, STEP, DELAY = 0.005, 2.5e-4, 0.004
SIGMA = np.array([5e-4, 5e-4, 8e-3, 8e-3])
LIBRARY = tuple(e for e in EFFECTS if e.name in ("actuator_delay", "viscous_damping", "actuator_gain", "armature"))
QUICK = Options(steps=2e5, leaders=4, contact_leaders=0)


def recording(seed: int, believed: mujoco.MjModel) -> Recording:
    """A controller that knows the joints' noisy angles sends torques, which arrive 4 ms late."""
    rng, model = np.random.default_rng(seed), mujoco.MjModel.from_xml_string(XML)
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    data, time = mujoco.MjData(model), np.arange(0, 0.9, INTERVAL)
    speed, phase = 2 * np.pi * rng.uniform(0.4, 2.0, (2, 2)), rng.uniform(0, 6.28, (2, 2))
    sent, states = np.empty((len(time), 2)), np.empty((len(time), 4))
    every = round(INTERVAL / STEP)
    for k, t in enumerate(time):
        states[k] = [*data.qpos, *data.qvel] + SIGMA * rng.standard_normal(4)
        wanted = 0.3 * np.sin(t * speed + phase).sum(1)
        sent[k] = [20.0, 4.0] * (wanted - states[k, :2]) - [1.0, 0.15] * states[k, 2:]
        for i in range(every):
            data.ctrl[:] = sent[max(0, int(np.floor((t + (i + 0.5) * STEP - DELAY) / INTERVAL)))]
            mujoco.mj_step(model, data)
    split = "fit" if seed < 3 else "test"
    qpos, qvel, known = states[:, :2], states[:, 2:], np.ones(2, bool)
    return Recording(f"r{seed}", time, sent, qpos, qvel, known, split, believed, interpolation="hold")


@pytest.fixture(scope="module")
def late() -> Dataset:
    believed = mujoco.MjModel.from_xml_string(XML)
    return Dataset(Path(), believed, Path("arm.xml"), XML, (), tuple(recording(seed, believed) for seed in range(5)))


@pytest.fixture(scope="module")
def bench(late: Dataset) -> Bench:
    return Bench(late, LIBRARY, QUICK)


@pytest.mark.parametrize("single", [True, False])
def test_a_delay_of_what_is_held_is_seen(bench: Bench, single: bool) -> None:
    """The command jumps at samples only, where single steps in the middle of intervals see nothing."""
    windows = bench.fit.windows
    assert all(isinstance(c, Command) and c.interpolation == "hold" for c in windows.data.commands)
    candidate = next(c for c in bench.candidates if c.name == "actuator_delay@all")
    make = bench.base.with_effect(candidate, [5e-4])
    found = signatures(windows, bench.base, [make], single)[0]
    change = windows.residuals([make])[0] - windows.residual
    assert np.linalg.norm(change) > 1.0
    assert (found * change).sum() / np.linalg.norm(found) / np.linalg.norm(change) > 0.95
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(change), rel=0.15)


def test_noise_is_not_what_the_controller_does(bench: Bench) -> None:
    np.testing.assert_array_less(bench.sigma, 3.0 * SIGMA)


def test_a_delay_of_held_torques_is_named(late: Dataset) -> None:
    found = identify(late, LIBRARY, max_effects=1, options=QUICK)
    (named,) = found.effects
    assert named.name == "actuator_delay@all"
    assert named.parameters["delay"].value == pytest.approx(DELAY, rel=0.1)
