"""A four-bar linkage: the loop is closed by an equality constraint, and one motor drives three joints."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import Dataset, Noise, Recording
from btr_mjx.gap.effects import EFFECTS, Scales
from btr_mjx.gap.inference import Bench, identify
from btr_mjx.gap.simulate import Command
from btr_mjx.gap.windows import Options

XML = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom density="2000" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="crank">
      <joint name="crank" axis="0 1 0" damping="0.05"/><geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.015"/>
      <body name="rod" pos="0 0 0.1">
        <joint name="rod" axis="0 1 0" damping="0.02"/><geom type="capsule" fromto="0 0 0 0.3 0 0.08" size="0.01"/>
      </body>
    </body>
    <body name="rocker" pos="0.3 0 0">
      <joint name="rocker" axis="0 1 0" damping="0.02"/><geom type="capsule" fromto="0 0 0 0 0 0.18" size="0.012"/>
    </body>
  </worldbody>
  <equality><connect body1="rod" body2="rocker" anchor="0.3 0 0.08"/></equality>
  <actuator><position name="motor" joint="crank" kp="20" kv="1"/></actuator>
</mujoco>
"""
SIGMA = np.array([5e-4] * 3 + [5e-3] * 3)
LIBRARY = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature", "actuator_gain", "actuator_lag"))
QUICK = Options(steps=1.2e5, leaders=4, contact_leaders=0)


def recording(seed: int, believed: mujoco.MjModel) -> Recording:
    """0.15 N m s/rad too many at the rocker, in steps of 1e-4 s."""
    rng, model = np.random.default_rng(seed), mujoco.MjModel.from_xml_string(XML)
    model.opt.timestep = 1e-4
    model.dof_damping[2] += 0.15
    time = np.arange(0, 1.0, 0.004)
    speed, phase = 2 * np.pi * rng.uniform(0.4, 3, 3), rng.uniform(0, 6.28, 3)
    command = Command(time, 0.25 * np.sin(time[:, None] * speed + phase).sum(1, keepdims=True), "cubic")
    data, states = mujoco.MjData(model), np.empty((len(time), 6))
    controls = command.at(np.arange(40 * len(time)) * 1e-4)
    for i, control in enumerate(controls):
        if i % 40 == 0:
            states[i // 40] = [*data.qpos, *data.qvel]
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
    states += SIGMA * rng.standard_normal(states.shape)
    split = "fit" if seed < 3 else "test"
    return Recording(f"r{seed}", time, command.values, states[:, :3], states[:, 3:], np.ones(3, bool), split, believed)


@pytest.fixture(scope="module")
def linkage() -> Dataset:
    believed = mujoco.MjModel.from_xml_string(XML)
    recordings = tuple(recording(seed, believed) for seed in range(5))
    return Dataset(Path(), believed, Path("linkage.xml"), XML, (), recordings, noise=Noise(SIGMA[:3], SIGMA[3:]))


def test_a_loop_hands_on_the_power_of_its_motor(linkage: Dataset) -> None:
    r = linkage.recordings[0]
    scales = Scales.measured(r.model, r.qpos, r.qvel, r.ctrl)
    np.testing.assert_allclose((scales.torque * scales.speed)[1:], scales.torque[0] * scales.speed[0])
    without = mujoco.MjModel.from_xml_string(XML.replace("<connect", '<connect active="false"'))
    passive = Scales.measured(without, r.qpos, r.qvel, r.ctrl)
    assert (passive.torque[1:] < scales.torque[1:]).all()
    assert passive.torque[0] == scales.torque[0]


def test_signatures_in_a_loop_are_those_of_whole_simulations(linkage: Dataset) -> None:
    bench = Bench(linkage, LIBRARY, QUICK)
    windows, screened = bench.fit.windows, bench.scanner.screened
    index = next(i for i, e in enumerate(screened.entries) if e.candidate.name == "viscous_damping@joint:rocker")
    entry, signature = screened.entries[index], screened.signature(index)[0]
    change = windows.residuals([bench.base.with_effect(entry.candidate, entry.steps)])[0] - windows.residual
    cosine = (signature * change).sum() / np.linalg.norm(signature) / np.linalg.norm(change)
    assert cosine > 0.9


def test_damping_of_a_joint_without_a_motor_is_named(linkage: Dataset) -> None:
    found = identify(linkage, LIBRARY, max_effects=1, options=QUICK)
    (named,) = found.effects
    assert named.name == "viscous_damping@joint:rocker"
    assert named.parameters["damping"].value == pytest.approx(0.15, rel=0.1)
    assert not named.parameters["damping"].edge
