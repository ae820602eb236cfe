"""Robot: an MJCF template, a space of simulations, a space of controllers and a reference signal.

To define your own robot, write a robot.toml (`models.load_robot`), or an MJCF file with Jinja2 variables for its
unknown parameters, and make a `Robot`:

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import jinja2
import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError, one_line
from btr_mjx.robots.spaces import Box
from btr_mjx.robots.template_language import TemplateEnvironment
from btr_mjx.runs import read_text

Signal = Callable[[Any, Any, Any], Any]
"""signal(controller, time, xp): controls (n_u, ...) at one time [s] of controllers (n_c, ...).

xp is numpy or jax.numpy. The parameters come first and the batch last. Only elementwise functions of `xp` may be
applied to the batch.
"""


_SHOWN = 8
"""Names of a space that a robot's repr has."""


class Edit(Protocol):
    """Changes numbers of a compiled model. Edits are compared and hashed, as they belong to the key of caches."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters of S that it takes."""
        ...

    def __call__(self, model: Any, values: Sequence[float]) -> None:
        """Change a model in place; `mj_setConst` is called after the last edit.

        Args:
          model: an `mujoco.MjModel`.
          values: one per parameter.
        """
        ...


@dataclass(frozen=True, eq=False)
class Pairs:
    """B pairs (s, c) for a `Simulator`.

    Attributes:
      models: (L,) `mujoco.MjModel`s of the simulations.
      simulations: (L, n_s).
      index: (B,) simulation of each pair.
      controllers: (B, n_c) controller of each pair.
      times: (K,) ascending sample times, whole time steps [s].
      timestep: [s].
    """

    models: Sequence[Any]
    simulations: np.ndarray
    index: np.ndarray
    controllers: np.ndarray
    times: np.ndarray
    timestep: float


class Simulator(Protocol):
    """Simulates pairs where the engines cannot: forces that depend on the state, edited commands, another simulator.

    Simulators are compared and hashed.
    """

    def __call__(self, robot: "Robot", pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
        """Simulate the trials of pairs.

        Returns:
          qpos (B, K, nq) and qvel (B, K, nv); NaN from the first invalid state of a pair on.
        """
        ...


@dataclass(frozen=True, repr=False)
class Robot:
    """A robot whose simulation is not fully known.

    Attributes:
      name: for run folders and figures.
      template: Jinja2 text of the MJCF; its variables are the names of `simulation_box` that no edit takes and of
        `constants`, and the functions sin, cos, radians, sqrt, min and max.
      template_path: where the template came from, for messages.
      simulation_box: the space S of simulations.
      controller_box: the space C of controllers.
      signal: the reference that the motors track, see `Signal`.
      nominal: the simulation assumed before any measurement, one value per parameter of S.
      constants: (name, value) pairs that the template needs in addition to the parameters of S.
      base_body: the body with the free joint whose position is measured; None for a robot with a fixed base.
      edits: changes of the compiled model by the other parameters of S, in this order.
      simulator: in place of the engines; the work of the motors and their activations are not known then.
      folder: folder of included files and meshes, "" for none.
      plain: the text is MJCF as it stands, not a template.
      keyframe: name of the keyframe in which trials start; "" for the model's qpos0.
      point: site or body whose position is measured instead of the base's, for a robot with a fixed base.
      fitness: name of the fitness function that commands use unless another is asked for.
      target: point that the fitness function "target_distance" refers to [m].
      duration: T_e, duration of a trial [s].
      speed_limit: maximum plausible speed of the base [m/s]; a pair that exceeds it counts as diverged.
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
    edits: tuple[Edit, ...] = ()
    simulator: Simulator | None = None
    folder: str = ""
    plain: bool = False
    keyframe: str = ""
    point: str = ""
    fitness: str = "distance"
    target: tuple[float, ...] = ()
    duration: float = 1.7
    speed_limit: float = 50.0

    @staticmethod
    def expect(robot: object) -> None:
        """Check that an argument is a robot.

        Raises:
          InputError: it is something else.
        """
        if not isinstance(robot, Robot):
            raise InputError(f"robot: got {robot!r}, expected a Robot; load_robot(FILE) gives that of a robot.toml")

    def __post_init__(self) -> None:
        self.simulation_box.validate(self.nominal, "nominal simulation")
        if not (self.duration > 0 and math.isfinite(self.duration)):
            raise InputError(f"duration: got {self.duration}, expected a positive time in seconds")
        for edit in self.edits:
            for name in edit.parameters:
                self.simulation_box.index(name)

    def __repr__(self) -> str:
        """Three lines: what it is, its simulations and its controllers."""
        lines = [f"Robot {self.name!r} of {self.template_path}, trials of {self.duration:g} s, fitness {self.fitness}"]
        for kind, box in (("simulations", self.simulation_box), ("controllers", self.controller_box)):
            names = box.names if box.n <= _SHOWN else (*box.names[: _SHOWN - 2], "...", box.names[-1])
            lines.append(f"  {kind}: {box.n} parameter{'s' if box.n > 1 else ''} ({', '.join(names)})")
        return "\n".join(lines)

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
        if self.plain:
            return self.template
        edited = {name for edit in self.edits for name in edit.parameters}
        named = zip(self.simulation_box.names, values.tolist(), strict=True)
        names = {name: value for name, value in named if name not in edited}
        try:
            return _compiled_template(self.template).render(dict(self.constants) | names)
        except jinja2.UndefinedError as error:
            known = ", ".join([*names, *dict(self.constants)])
            raise InputError(
                f"{self.template_path}: {error.message}{_template_line(error)}; the template may use: {known}"
            ) from None
        except RecursionError as error:
            raise InputError(
                f"{self.template_path}: cannot be rendered: macros call themselves too deeply{_template_line(error)}"
            ) from None
        except Exception as error:  # a template computes: sqrt of a negative number, a key that is not there, ...
            raise InputError(
                f"{self.template_path}: cannot be rendered: {_words(error)}{_template_line(error)}"
            ) from None

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


@lru_cache(maxsize=64)
def _compiled_template(text: str) -> jinja2.Template:
    """The compiled Jinja2 template of a text, with the functions sin, cos, radians, sqrt, min and max."""
    return TemplateEnvironment().template(text)


def _words(error: Exception) -> str:
    """The error's message; without the place that a syntax error of Jinja2 repeats on lines of its own."""
    return str(error.message if isinstance(error, jinja2.TemplateSyntaxError) else error) or type(error).__name__


def _template_line(error: BaseException) -> str:
    """' (line N)' of the template, from the traceback, which Jinja2 rewrites to point into the template; else ''."""
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
        return read_text(path)
    except (OSError, InputError) as error:
        raise InputError(f"template {str(path)!r} cannot be read: {one_line(error)}") from None
