"""Robots of demonstrations: the believed MJCF, random commands, and the noise of the sensors."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.robots import hexapod, read_asset

MotionCommand = Callable[[np.ndarray], np.ndarray]
"""Commands (N, nu) at times (N,) [s]."""


@dataclass(frozen=True)
class DemoRobot:
    """A robot of a demonstration.

    Attributes:
      name: name of the robot.
      xml: MJCF text of the believed model.
      draw_motion: draws a random command.
      duration: duration of a recording [s].
      base: body with the free joint; None for a robot with a fixed base.
      noise: standard deviations of hinges (angle [rad], speed [rad/s]) and of the base (position [m], rotation [rad],
        velocity [m/s], angular velocity [rad/s]).
      tempo: typical angular frequency of the motion [rad/s].
    """

    name: str
    xml: str
    draw_motion: Callable[[np.random.Generator], MotionCommand]
    duration: float
    base: str | None
    noise: tuple[float, float, float, float, float, float]
    tempo: float

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


def _pendulum_motion(rng: np.random.Generator) -> MotionCommand:
    return _sinusoids(rng, np.zeros(1), np.array([1.3]), 1.5, 12.0)


def _quadruped_motion(rng: np.random.Generator) -> MotionCommand:
    """A random gait near a trot: one frequency, phases by leg, amplitudes by joint."""
    frequency = rng.uniform(12.0, 22.0)
    phase = np.repeat(np.array([0, np.pi, np.pi, 0]) + rng.normal(0, 0.6, 4), 3) + np.tile([0, 0, 1.5], 4)
    amplitude = np.tile(rng.uniform([0.02, 0.1, 0.1], [0.12, 0.35, 0.35]), 4) * rng.uniform(0.7, 1.3, 12)
    return lambda t: amplitude * (np.sin(frequency * t[:, None] + phase) - np.sin(phase) * np.exp(-10 * t[:, None]))


def _arm_motion(rng: np.random.Generator) -> MotionCommand:
    centre = np.array([0.0, -0.3, 0.6, 0.2, 0.0])
    motion = _sinusoids(rng, centre, np.array([0.8, 0.6, 0.7, 0.8, 1.0]), 2.0, 12.0)
    return lambda t: motion(t) - np.exp(-8 * t[:, None]) * motion(np.zeros(1))


def demo_robot(name: str) -> DemoRobot:
    """A robot of demonstrations by name.

    Args:
      name: hexapod, pendulum, quadruped or arm.

    Returns:
      The robot.

    Raises:
      InputError: there is none of that name.
    """
    robots = _robots()
    if name not in robots:
        raise InputError(f"robot {name!r}: expected one of {', '.join(robots)}")
    return robots[name]


@cache
def _robots() -> dict[str, DemoRobot]:
    walker = hexapod()
    xml = {name: read_asset(f"{name}.xml") for name in ("pendulum", "quadruped", "arm")}
    xml["hexapod"] = walker.render(walker.nominal)
    still = (0.0, 0.0, 0.0, 0.0)
    robots = (
        DemoRobot(
            name="hexapod",
            xml=xml["hexapod"],
            draw_motion=_hexapod_motion,
            duration=walker.duration,
            base=walker.base_body,
            noise=(1e-3, 0.05, 1e-3, 2e-3, 0.02, 0.03),
            tempo=60.0,
        ),
        DemoRobot("pendulum", xml["pendulum"], _pendulum_motion, 4.0, None, (5e-4, 0.01, *still), 6.0),
        DemoRobot(
            name="quadruped",
            xml=xml["quadruped"],
            draw_motion=_quadruped_motion,
            duration=2.0,
            base="trunk",
            noise=(5e-4, 0.02, 1e-3, 1e-3, 0.01, 0.02),
            tempo=17.0,
        ),
        DemoRobot("arm", xml["arm"], _arm_motion, 3.0, None, (3e-4, 0.01, *still), 6.0),
    )
    return {robot.name: robot for robot in robots}
