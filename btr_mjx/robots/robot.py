"""What a robot is: a template of its model, a space of simulations, a space of controllers, a reference signal.

The hexapod of "Fitness Based Identification of a Robot Structure" is `hexapod()`. To bring one's own robot, write an
MJCF file with Jinja2 variables for what is unknown about it and make a `Robot`:

    robot = Robot(
        name="monoped",
        template=Path("monoped.xml.j2").read_text(),
        template_path="monoped.xml.j2",
        simulation_box=Box(["thigh", "shank"], 0.1, 0.5),
        controller_box=Box(["amplitude", "phase"], [0.0, 0.0], [0.5, 3.14]),
        signal=my_signal,
        nominal=(0.3, 0.3),
    )
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from jinja2.sandbox import SandboxedEnvironment
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.robots.spaces import Box

Signal = Callable[[Any, Any, Any], Any]
"""signal(controller, time, xp): controls (n_u, ...) at one time [s] of controllers (n_c, ...).

xp is numpy or jax.numpy. The parameters come first and the batch last. Only elementwise arithmetic of `xp` may be used
on the batch.
"""


@dataclass(frozen=True)
class Robot:
    """A robot whose simulation is not fully known.

    Attributes:
      name: for run folders and figures.
      template: Jinja2 text of the MJCF; its variables are the names of `simulation_box` and of `constants`, and the
        functions sin, cos, radians, sqrt, min and max.
      template_path: where the template came from, for messages.
      simulation_box: the space S of simulations.
      controller_box: the space C of controllers.
      signal: the reference that the motors track, see `Signal`.
      nominal: the simulation that is believed before anything is measured, one value per parameter of S.
      constants: (name, value) pairs that the template needs beside the parameters of S.
      base_body: the body with the free joint whose position is measured; None for a robot that is bolted down.
      duration: T_e, the time that a controller is tried for [s].
      speed_limit: a base faster than this [m/s] is a numerical accident, not a gait: the pair counts as diverged.
    """

    name: str
    template: str
    template_path: str
    simulation_box: Box
    controller_box: Box
    signal: Signal
    nominal: tuple[float, ...]
    constants: tuple[tuple[str, float], ...] = ()
    base_body: str | None = None
    duration: float = 1.7
    speed_limit: float = 50.0

    def __post_init__(self) -> None:
        self.simulation_box.validate(self.nominal, "nominal simulation")
        if not (self.duration > 0 and math.isfinite(self.duration)):
            raise InputError(f"duration: got {self.duration}, expected a positive time in seconds")

    @property
    def nominal_simulation(self) -> np.ndarray:
        """The nominal parameters as an array (n_s,)."""
        return np.array(self.nominal)

    def render(self, simulation: ArrayLike) -> str:
        """MJCF of one simulation.

        Args:
          simulation: (n_s,) parameters inside `simulation_box`.

        Returns:
          The rendered text.

        Raises:
          InputError: parameters outside the box, or a template with an undefined variable or broken syntax.
        """
        values = self.simulation_box.validate(simulation, "simulation")
        if values.ndim != 1:
            raise InputError(
                f"simulation: got shape {values.shape}, expected one row of {self.simulation_box.n} values"
            )
        names = dict(zip(self.simulation_box.names, values.tolist(), strict=True))
        try:
            return compiled_template(self.template).render(dict(self.constants) | names)
        except jinja2.UndefinedError as error:
            known = ", ".join([*self.simulation_box.names, *dict(self.constants)])
            raise InputError(
                f"{self.template_path}: {error.message}{_template_line(error)}; the template may use: {known}"
            ) from None
        except (ArithmeticError, TypeError, jinja2.TemplateError) as error:
            raise InputError(f"{self.template_path}: cannot be rendered: {error}{_template_line(error)}") from None

    def with_constants(self, **constants: float) -> "Robot":
        """The same robot with some constants changed.

        Args:
          **constants: new values of existing constants.

        Raises:
          InputError: a name that the robot does not have.
        """
        known = dict(self.constants)
        for name in constants:
            if name not in known:
                raise InputError(f"constant {name!r} does not exist; the robot has: {', '.join(known)}")
        return replace(self, constants=tuple((known | constants).items()))


_TEMPLATE_FUNCTIONS: Mapping[str, Any] = {
    "sin": math.sin,
    "cos": math.cos,
    "radians": math.radians,
    "sqrt": math.sqrt,
    "min": min,
    "max": max,
}


@lru_cache(maxsize=64)
def compiled_template(text: str) -> jinja2.Template:
    """The template of a text, with the functions that templates may use."""
    environment = SandboxedEnvironment(undefined=jinja2.StrictUndefined, autoescape=False)
    environment.globals.update(_TEMPLATE_FUNCTIONS)
    return environment.from_string(text)


def _template_line(error: BaseException) -> str:
    """' (line N)' where the template's own frame says it; Jinja2 rewrites tracebacks so that they point there."""
    if isinstance(error, jinja2.TemplateSyntaxError):
        return f" (line {error.lineno})"
    line, trace = None, error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename in ("<template>", "<unknown>"):
            line = trace.tb_lineno
        trace = trace.tb_next
    return f" (line {line})" if line is not None else ""


def read_template(path: str | Path) -> str:
    """Text of a template file.

    Raises:
      InputError: the file cannot be read as UTF-8 text.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"template {str(path)!r} cannot be read: {error}") from None


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
    "gaster_rise": 0.1,  # by how much the gaster's end stands above its root [m]
    "gaster_radius": 0.2,  # [m]
    "limb_radius": 0.06,  # femurs, tibiae, knees and feet [m]
    # Default posture.
    "hip_offset": 0.2,  # lateral distance of the hips from the trunk's axis [m]
    "fan": math.radians(35),  # front and rear legs are turned outwards by this [rad]
    "femur_up": math.radians(20),  # femurs rise by this from hip to knee [rad]
    "tibia_down": math.radians(75),  # tibiae fall by this from knee to foot [rad]
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
"""Constants of the hexapod with their units, chosen by the recorded calibration `experiments/calibrate_robot.py`."""


def sinusoids(controller: Any, time: Any, xp: Any) -> Any:
    """r_i = theta_i + a_i sin(omega t + phi_i), the paper's reference, in a default posture of theta_i = 0.

    Args:
      controller: (2 n_u, ...) parameters a_1, phi_1, a_2, phi_2, ... [rad].
      time: t [s].
      xp: numpy or jax.numpy.

    Returns:
      (n_u, ...) joint angles [rad].
    """
    return controller[0::2] * xp.sin(OMEGA * time + controller[1::2])


@cache
def hexapod(**constants: float) -> Robot:
    """The paper's hexapod: 12 limb lengths bl_3..bl_14 in [0.4, 1.6] m, 18 motors, T_e = 1.7 s.

    Args:
      **constants: values that replace entries of `HEXAPOD`.

    Returns:
      The robot. Femurs bl_3..bl_8 and tibiae bl_9..bl_14 belong to the legs right front, right middle, right rear,
      left front, left middle, left rear, in this order. Motors 1..12 are the vertical and frontal axes of the femur
      joints j2..j7, motors 13..18 the knees j8..j13.
    """
    source = files("btr_mjx").joinpath("assets/hexapod.xml.j2")
    if not source.is_file():  # an editable install: assets/ lies beside the package
        source = files("btr_mjx").joinpath("../assets/hexapod.xml.j2")
    motors = range(1, 19)
    return Robot(
        name="hexapod",
        template=source.read_text(encoding="utf-8"),
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
    ).with_constants(**constants)


def robot_of(template: str | Path | None = None, duration: float = 1.7) -> Robot:
    """The hexapod, or one with another template of the same parameters and motors, as commands take it.

    Args:
      template: file of the template; None for the paper's hexapod.
      duration: T_e [s].

    Raises:
      InputError: a template that cannot be read, a duration that is not positive.
    """
    robot = replace(hexapod(), duration=duration)
    if template is None:
        return robot
    return replace(robot, template=read_template(template), template_path=str(template))
