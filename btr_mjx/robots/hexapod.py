"""The hexapod of "Fitness Based Identification of a Robot Structure": its constants, spaces and reference signal."""

import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from btr_mjx.robots.robot import Robot
from btr_mjx.robots.spaces import Box

OMEGA = 60.0
"""Angular frequency of every motor's reference [rad/s]. The paper prints "omega = 60 Hz" inside sin(omega t)."""

HEXAPOD: Mapping[str, float] = {
    # Simulation.
    "timestep": 5e-4,  # dt [s], the paper's
    "solver_iterations": 100,
    "linesearch_iterations": 50,
    "solver_tolerance": 1e-10,
    # Bodies. The uniform density makes a robot of about 70 kg; see experiments/calibrate_robot.py.
    "density": 200.0,  # [kg/m^3]
    "trunk_half": 0.5,  # half length of the alitrunk b0 [m]
    "trunk_radius": 0.15,  # [m]
    "petiole": 0.3,  # length of b1 [m]
    "gaster": 0.6,  # length of b2 [m]
    "gaster_rise": 0.1,  # height of the gaster's end above its root [m]
    "gaster_radius": 0.2,  # [m]
    "limb_radius": 0.06,  # femurs, tibiae, knees and feet [m]
    # Default posture.
    "hip_offset": 0.2,  # lateral distance of the hips from the trunk's axis [m]
    "fan": math.radians(35),  # outward rotation of front and rear legs [rad]
    "femur_up": math.radians(20),  # elevation of the femurs from hip to knee [rad]
    "tibia_down": math.radians(75),  # depression of the tibiae from knee to foot [rad]
    "start_clearance": 0.01,  # gap between the lowest foot and the ground at t = 0 [m]
    # Joints and motors: tau = kp e + ki int(e) dt - kv dq/dt, e = r - q.
    "kp": 2000.0,  # [N m/rad]
    "ki": 1000.0,  # [N m/(rad s)]
    "kv": 200.0,  # [N m s/rad]
    "joint_damping": 1.0,  # [N m s/rad]
    "joint_armature": 0.0,  # [kg m^2]
    # Contact.
    "friction": 0.8,  # sliding coefficient [1]
    "contact_time_constant": 0.02,  # solref [s]
}
"""Constants of the hexapod with their units, chosen by `experiments/calibrate_robot.py`."""


def read_asset(name: str) -> str:
    """Text of a file in assets/."""
    source = files("btr_mjx").joinpath("assets", name)
    if not source.is_file():  # an editable install: assets/ lies beside the package
        source = files("btr_mjx").joinpath("../assets", name)
    return source.read_text(encoding="utf-8")


def sinusoids(controller: Any, time: Any, xp: Any) -> Any:
    """r_i = theta_i + a_i sin(omega t + phi_i), the paper's reference, in a default posture of theta_i = 0.

    Of controllers (2 n_u, ...) with a_1, phi_1, a_2, phi_2, ... [rad] it gives joint angles (n_u, ...) [rad], see
    `Signal`.
    """
    return controller[0::2] * xp.sin(OMEGA * time + controller[1::2])


def hexapod(**constants: float) -> Robot:
    """The paper's hexapod: 12 limb lengths bl_3..bl_14 in [0.4, 1.6] m, 18 motors, T_e = 1.7 s.

    Args:
      **constants: values that replace entries of `HEXAPOD`.

    Returns:
      The robot. Femurs bl_3..bl_8 and tibiae bl_9..bl_14 belong to the legs right front, right middle, right rear,
      left front, left middle, left rear, in this order. Motors 1..12 are the vertical and frontal axes of the femur
      joints j2..j7, motors 13..18 the knees j8..j13.
    """
    return _hexapod(tuple(sorted(constants.items())))


@cache  # of a function of its own, since editors show no parameters of a decorated one
def _hexapod(constants: tuple[tuple[str, float], ...]) -> Robot:
    motors = range(1, 19)
    return Robot(
        name="hexapod",
        template=read_asset("hexapod.xml.j2"),
        template_path="assets/hexapod.xml.j2",
        simulation_box=Box([f"bl_{body}" for body in range(3, 15)], 0.4, 1.6, units="m"),
        controller_box=Box(
            [name for i in motors for name in (f"a_{i}", f"phi_{i}")],
            [0.12989, 0.0] * 18,
            [0.314, 3.1416] * 18,
            units="rad",
        ),
        signal=sinusoids,
        nominal=(0.64,) * 6 + (1.36,) * 6,
        constants=tuple(HEXAPOD.items()),
        base_body="b0",
    ).with_constants(**dict(constants))


PAPER_STARTS: Mapping[str, float] = {"bl_14": 0.4, "bl_5": 0.64}
"""Parameter -> its value in the simulation of Fig. 2 in which the controllers evolve [m]."""

PAPER_REALITIES: Mapping[str, Mapping[str, float]] = {
    "fig2": {"bl_5": 0.88, "bl_14": 1.6},
    "fig4": {"bl_3": 0.54, "bl_5": 0.54, "bl_6": 0.74, "bl_8": 0.74},
}
"""Lengths of the simulated reality in the paper, by figure [m]; all others are nominal."""
