"""A small arm, simulated, and what its logs say."""

from dataclasses import dataclass

import mujoco
import numpy as np
from stepping import stepped

ARM = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 0 1" damping="0.2" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/>
      <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" damping="0.1" armature="0.005"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.015" mass="0.2"/></body></body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="20" kv="0.5"/>
    <position name="elbow" joint="elbow" kp="10" kv="0.3"/>
  </actuator>
</mujoco>"""

FLOATER = """<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body name="trunk"><freejoint name="root"/>
      <geom type="box" size="0.2 0.1 0.05" mass="1"/>
      <body name="arm" pos="0.2 0 0"><joint name="hip" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.3"/></body></body>
  </worldbody>
  <actuator><position name="hip" joint="hip" kp="5" kv="0.2"/></actuator>
</mujoco>"""


@dataclass(frozen=True)
class RobotLog:
    """What a robot did, every millisecond."""

    time: np.ndarray
    ctrl: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray

    def every(self, step: int, first: int = 0) -> "RobotLog":
        rows = slice(first, None, step)
        return RobotLog(self.time[rows], self.ctrl[rows], self.qpos[rows], self.qvel[rows])


def simulated_log(xml: str, seconds: float = 3.0, hold: int = 1, seed: int = 0) -> RobotLog:
    """A robot that follows sines; commands change every `hold` milliseconds."""
    model = mujoco.MjModel.from_xml_string(xml)
    rng = np.random.default_rng(seed)
    speed, phase = rng.uniform(3, 9, model.nu), rng.uniform(0, 6, model.nu)
    start = model.qpos0, 0.4 * rng.standard_normal(model.nv)
    count = round(1000 * seconds)
    time = 1e-3 * np.arange(count)
    sent = 0.4 * np.sin(speed * time[::hold, None].repeat(hold, 0)[:count] + phase)
    qpos, qvel = stepped(model, sent[:-1], start)
    return RobotLog(time, sent, qpos, qvel)
