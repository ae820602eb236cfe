"""A two-link arm with position servos and recordings of it, for tests of the gap workflow."""

from pathlib import Path

import mujoco
import numpy as np
from stepping import stepped

from btr_mjx.gap.data import Dataset, Noise, Recording
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.simulate import Command, World
from btr_mjx.gap.windows import Options, Span, Windows, linearise, prepare
from btr_mjx.models import PathParameter

XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.05"/>
      <geom name="upper" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" damping="0.05"/>
        <geom name="lower" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="cord" springlength="-9 0"><joint joint="elbow" coef="1"/></fixed>
  </tendon>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="20" kv="0.5"/>
    <position name="elbow" joint="elbow" kp="10" kv="0.2"/>
  </actuator>
</mujoco>
"""

SIGMA = np.array([1e-3, 1e-3, 0.01, 0.01])


def arm() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(XML)


def command(rng, duration=0.7, rate=200.0):
    time = np.arange(0.0, duration, 1 / rate)
    phase, speed = rng.uniform(0, 6.28, 2), rng.uniform(3, 9, 2)
    return Command(time, rng.uniform(0.4, 0.9, 2) * np.sin(time[:, None] * speed + phase), "cubic")


def recording(
    name, change=None, seed=0, split="fit", noise=1.0, believed=None, uneven=False, duration=1.5, arrive=None
):
    """A recording of the arm after `change(model)`, simulated with steps of 1e-4 s.

    `arrive(sent, time)` gives the commands that come to the motors (T, nu); None for those that were sent.
    """
    rng = np.random.default_rng(seed)
    sent = command(rng, duration)
    model = arm()
    model.opt.timestep = 1e-4
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    if change is not None:
        change(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    steps = round(sent.times[-1] / 1e-4)
    starts = np.arange(steps) * 1e-4
    controls = sent.at(starts) if arrive is None else arrive(sent, starts)
    states = np.concatenate(stepped(model, controls), axis=1)
    index = np.round(sent.times / 1e-4).astype(int)
    if uneven:
        index = np.sort(np.clip(index + rng.integers(-12, 13, len(index)), 0, steps))
        index = np.unique(index)
    time = index * 1e-4
    seen = states[index] + noise * SIGMA * rng.standard_normal((len(index), 4))
    return Recording(
        name,
        time,
        sent.at(time),
        seen[:, :2],
        seen[:, 2:],
        np.ones(2, bool),
        split,
        believed or arm(),
        interpolation="cubic",
    )


def dataset(change=None, seed=0, fit=3, test=2, parameters: tuple[PathParameter, ...] = (), noise=1.0):
    believed = arm()
    recordings = tuple(
        recording(f"r{i}", change, 100 * seed + i, "fit" if i < fit else "test", noise, believed, duration=0.7)
        for i in range(fit + test)
    )
    known = Noise(SIGMA[:2].copy(), SIGMA[2:].copy())
    return Dataset(Path(), believed, Path("arm.xml"), XML, parameters, recordings, noise=known)


def arm_windows() -> Windows:
    """Four windows of two recordings of the arm, linearised around it."""
    data = prepare([recording(f"r{i}", seed=i) for i in range(2)], SIGMA, Span(5, 6))
    out = Windows(data, np.array([0, 0, 1, 1]), np.array([10, 150, 20, 200]), 30)
    out = linearise(out, World.of)
    return out


def elbow_off() -> Dataset:
    """Recordings of an arm whose elbow is 20 mrad off."""

    def turned(model):
        model.body_quat[2] = [np.cos(0.01), 0.0, np.sin(0.01), 0.0]

    return dataset(turned, seed=4, fit=3, test=1)


LIBRARY = tuple(
    e for e in EFFECTS if e.name in ("viscous_damping", "dry_friction", "armature", "actuator_gain", "actuator_delay")
)
QUICK = Options(steps=6e4, leaders=4, contact_leaders=0)


def damped(model):
    model.dof_damping[1] += 0.1
