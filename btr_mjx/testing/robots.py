"""Robots for hidden cases: the believed MJCF, random commands, and the noise of the sensors.

There are four: the hexapod of this project, a servo with a pendulum, a quadruped and an arm. Missing effects are added
in `physics`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.robots import hexapod

MotionCommand = Callable[[np.ndarray], np.ndarray]
"""Commands (N, nu) at times (N,) [s]."""


@dataclass(frozen=True)
class CaseRobot:
    """A robot for hidden cases.

    Attributes:
      name: name of the robot.
      xml: MJCF text of the believed model.
      draw_motion: draws a random command.
      duration: duration of a recording [s].
      base: body with the free joint; None for a robot with a fixed base.
      floor: geom on which it stands; None for none.
      legs: root bodies of the limbs, for effects on all joints of a limb.
      links: bodies whose length may differ.
      noise: standard deviations of hinges (angle [rad], speed [rad/s]) and of the base (position [m], rotation [rad],
        velocity [m/s], angular velocity [rad/s]).
      tempo: typical angular frequency of the motion [rad/s].
      drag: range from which the density of a medium is drawn [kg/m^3].
    """

    name: str
    xml: str
    draw_motion: Callable[[np.random.Generator], MotionCommand]
    duration: float
    base: str | None
    floor: str | None
    legs: tuple[str, ...]
    links: tuple[str, ...]
    noise: tuple[float, float, float, float, float, float]
    tempo: float
    drag: tuple[float, float]

    @property
    def model(self) -> mujoco.MjModel:
        """The believed model; every access compiles it."""
        return mujoco.MjModel.from_xml_string(self.xml)

    def sigma(self, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviations of the sensors.

        Args:
          model: the believed model.

        Returns:
          (nv,) of qpos and (nv,) of qvel, in SI units.
        """
        angle, speed, position, rotation, velocity, spin = self.noise
        qpos, qvel = np.full(model.nv, angle), np.full(model.nv, speed)
        for kind, first in zip(model.jnt_type, model.jnt_dofadr, strict=True):
            if kind == mujoco.mjtJoint.mjJNT_FREE:
                qpos[first : first + 6] = np.repeat([position, rotation], 3)
                qvel[first : first + 6] = np.repeat([velocity, spin], 3)
        return qpos, qvel


def _hexapod_motion(rng: np.random.Generator) -> MotionCommand:
    robot = hexapod()
    controller = robot.controller_box.sample(rng, 1)[0]
    return lambda times: robot.signal(controller[:, None], times, np).T


def _sinusoids(
    rng: np.random.Generator, centre: np.ndarray, amplitude: np.ndarray, low: float, high: float, terms: int = 3
) -> MotionCommand:
    """Sums of sinusoids with random frequencies in [low, high] rad/s, one sum for every control."""
    n = len(centre)
    frequency = np.exp(rng.uniform(np.log(low), np.log(high), (terms, n)))
    phase = rng.uniform(0, 2 * np.pi, (terms, n))
    share = rng.dirichlet(np.ones(terms), n).T * amplitude * rng.uniform(0.5, 1.0, n)
    offset = np.sum(share * np.sin(phase), axis=0) * rng.uniform(0, 1, n)
    return lambda t: centre - offset + np.sum(share * np.sin(frequency * t[:, None, None] + phase), axis=1)


PENDULUM_XML = """<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="servo" axis="0 -1 0" damping="0.04" armature="0.002"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.12" size="0.008" mass="0.03" contype="0" conaffinity="0"/>
      <geom name="weight" type="sphere" pos="0 0 -0.12" size="0.02" mass="0.4" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="servo" kp="1.6" forcerange="-0.8 0.8"/></actuator>
</mujoco>
"""


def _pendulum_motion(rng: np.random.Generator) -> MotionCommand:
    return _sinusoids(rng, np.zeros(1), np.array([1.3]), 1.5, 12.0)


def quadruped_xml() -> str:
    """MJCF of a quadruped of about 12 kg with 12 position servos."""
    legs, motors = [], []
    for name, x, y in (("fl", 0.2, 0.1), ("fr", 0.2, -0.1), ("rl", -0.2, 0.1), ("rr", -0.2, -0.1)):
        side = 1 if y > 0 else -1
        legs.append(f"""
      <body name="{name}_hip" pos="{x} {y} 0">
        <joint name="{name}_abduction" axis="1 0 0"/>
        <geom class="limb" fromto="0 0 0 0 {0.05 * side} 0" size="0.03" mass="0.5"/>
        <body name="{name}_thigh" pos="0 {0.05 * side} 0" quat="{np.cos(0.35)} 0 {np.sin(0.35)} 0">
          <joint name="{name}_swing" axis="0 1 0"/>
          <geom name="{name}_thigh" class="limb" fromto="0 0 0 0 0 -0.2" size="0.02" density="2500"/>
          <body name="{name}_shank" pos="0 0 -0.2" quat="{np.cos(-0.7)} 0 {np.sin(-0.7)} 0">
            <joint name="{name}_knee" axis="0 1 0"/>
            <geom name="{name}_shank" class="limb" fromto="0 0 0 0 0 -0.2" size="0.014" density="2500"/>
            <geom name="{name}_foot" class="foot" pos="0 0 -0.2" size="0.02"/>
          </body>
        </body>
      </body>""")
        motors += [f'<position name="{name}_{j}" joint="{name}_{j}"/>' for j in ("abduction", "swing", "knee")]
    return f"""<mujoco model="quadruped">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast" iterations="100" tolerance="1e-10">
    <flag autoreset="disable"/>
  </option>
  <default>
    <joint damping="0.1" armature="0.005"/>
    <position kp="80" kv="2"/>
    <default class="limb"><geom type="capsule" contype="0" conaffinity="0"/></default>
    <default class="foot">
      <geom type="sphere" mass="0" contype="0" conaffinity="1" condim="3" friction="0.8 0.005 0.0001"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" contype="1" conaffinity="0" friction="0.8 0.005 0.0001"/>
    <body name="trunk" pos="0 0 0.33">
      <freejoint name="root"/>
      <geom name="trunk" type="box" size="0.22 0.09 0.06" mass="7" contype="0" conaffinity="0"/>{"".join(legs)}
    </body>
  </worldbody>
  <actuator>
    {" ".join(motors)}
  </actuator>
</mujoco>
"""


def _quadruped_motion(rng: np.random.Generator) -> MotionCommand:
    """A random gait near a trot: one frequency, phases by leg, amplitudes by joint."""
    frequency = rng.uniform(12.0, 22.0)
    phase = np.repeat(np.array([0, np.pi, np.pi, 0]) + rng.normal(0, 0.6, 4), 3) + np.tile([0, 0, 1.5], 4)
    amplitude = np.tile(rng.uniform([0.02, 0.1, 0.1], [0.12, 0.35, 0.35]), 4) * rng.uniform(0.7, 1.3, 12)
    return lambda t: amplitude * (np.sin(frequency * t[:, None] + phase) - np.sin(phase) * np.exp(-10 * t[:, None]))


ARM_XML = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <default>
    <joint damping="0.3" armature="0.05"/>
    <geom type="capsule" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="column" pos="0 0 0.3">
      <joint name="yaw" axis="0 0 1"/>
      <geom name="column" fromto="0 0 -0.1 0 0 0.05" size="0.05" mass="2"/>
      <body name="upper" pos="0 0 0.05">
        <joint name="shoulder" axis="0 1 0"/>
        <geom name="upper" fromto="0 0 0 0.3 0 0" size="0.035" density="1500"/>
        <body name="lower" pos="0.3 0 0">
          <joint name="elbow" axis="0 1 0"/>
          <geom name="lower" fromto="0 0 0 0.25 0 0" size="0.03" density="1500"/>
          <body name="hand" pos="0.25 0 0">
            <joint name="wrist" axis="0 1 0" armature="0.01"/>
            <joint name="roll" axis="1 0 0" armature="0.005" damping="0.1"/>
            <geom name="hand" fromto="0 0 0 0.08 0.02 0" size="0.025" density="1500"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="yaw" joint="yaw" kp="300" kv="20"/>
    <position name="shoulder" joint="shoulder" kp="400" kv="25"/>
    <position name="elbow" joint="elbow" kp="200" kv="10"/>
    <position name="wrist" joint="wrist" kp="40" kv="2"/>
    <position name="roll" joint="roll" kp="15" kv="0.5"/>
  </actuator>
</mujoco>
"""


def _arm_motion(rng: np.random.Generator) -> MotionCommand:
    centre = np.array([0.0, -0.3, 0.6, 0.2, 0.0])
    motion = _sinusoids(rng, centre, np.array([0.8, 0.6, 0.7, 0.8, 1.0]), 2.0, 12.0)
    return lambda t: motion(t) - np.exp(-8 * t[:, None]) * (motion(np.zeros(1)) - 0.0)


@cache
def case_robots() -> dict[str, CaseRobot]:
    """All case robots by name."""
    hexapod_robot = hexapod()
    robots = (
        CaseRobot(
            name="hexapod",
            xml=hexapod_robot.render(hexapod_robot.nominal),
            draw_motion=_hexapod_motion,
            duration=1.7,
            base="b0",
            floor="ground",
            legs=tuple(f"b{i}" for i in range(3, 9)),
            links=tuple(f"b{i}" for i in range(3, 15)),
            noise=(1e-3, 0.05, 1e-3, 2e-3, 0.02, 0.03),
            tempo=60.0,
            drag=(5.0, 100.0),
        ),
        CaseRobot(
            name="pendulum",
            xml=PENDULUM_XML,
            draw_motion=_pendulum_motion,
            duration=4.0,
            base=None,
            floor=None,
            legs=(),
            links=("arm",),
            noise=(5e-4, 0.01, 0.0, 0.0, 0.0, 0.0),
            tempo=6.0,
            drag=(100.0, 2000.0),
        ),
        CaseRobot(
            name="quadruped",
            xml=quadruped_xml(),
            draw_motion=_quadruped_motion,
            duration=2.0,
            base="trunk",
            floor="floor",
            legs=("fl_hip", "fr_hip", "rl_hip", "rr_hip"),
            links=tuple(f"{leg}_{part}" for leg in ("fl", "fr", "rl", "rr") for part in ("thigh", "shank")),
            noise=(5e-4, 0.02, 1e-3, 1e-3, 0.01, 0.02),
            tempo=17.0,
            drag=(20.0, 400.0),
        ),
        CaseRobot(
            name="arm",
            xml=ARM_XML,
            draw_motion=_arm_motion,
            duration=3.0,
            base=None,
            floor=None,
            legs=("lower",),
            links=("upper", "lower"),
            noise=(3e-4, 0.01, 0.0, 0.0, 0.0, 0.0),
            tempo=6.0,
            drag=(50.0, 1000.0),
        ),
    )
    return {robot.name: robot for robot in robots}


def case_robot(name: str) -> CaseRobot:
    """A case robot by name.

    Args:
      name: hexapod, pendulum, quadruped or arm.

    Returns:
      The robot.

    Raises:
      InputError: there is none of that name.
    """
    robots = case_robots()
    if name not in robots:
        raise InputError(f"robot {name!r}: expected one of {', '.join(robots)}")
    return robots[name]
