"""A small robot and smooth recordings of it."""

import mujoco
import numpy as np

from btr_mjx.gap.data import Recording
from btr_mjx.models import integrate

XML = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="trunk" pos="0 0 0.5">
      <freejoint name="root"/>
      <geom name="trunk" size="0.1" mass="2"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0" damping="0.3" range="-1 1" limited="true"/>
        <geom name="thigh" type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.5"/>
        <body name="ball" pos="0.3 0 0">
          <joint name="wrist" type="ball"/>
          <geom name="ball" size="0.04" mass="0.1" friction="0.7 0.01 0.001"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><position name="hip_motor" joint="hip" kp="20" kv="1"/></actuator>
</mujoco>"""
MODEL = mujoco.MjModel.from_xml_string(XML)
COUNT = 60


def smooth_recording(name: str, rng: np.random.Generator, split: str = "fit", count: int = COUNT) -> Recording:
    """A smooth motion at uneven times, with its exact velocities."""
    time = np.cumsum(rng.uniform(0.004, 0.006, count))
    speed, phase = rng.uniform(1, 3, MODEL.nv), rng.uniform(0, 6, MODEL.nv)
    start = np.array(MODEL.qpos0)
    qpos = integrate(MODEL, start, 0.3 * np.sin(speed * time[:, None] + phase))
    qvel = np.empty((count, MODEL.nv))
    for k in range(count):  # MuJoCo's own difference quotient is the oracle of velocities
        ends = [integrate(MODEL, start, 0.3 * np.sin(speed * (time[k] + s * 1e-5) + phase)) for s in (-1, 1)]
        mujoco.mj_differentiatePos(MODEL, qvel[k], 2e-5, *ends)
    return Recording(
        name, time, np.sin(time)[:, None], qpos, qvel, np.ones(MODEL.nv, bool), split, MODEL, {"hip_motor": time}
    )
