"""Simulations s -> rendered MJCF -> compiled models -> one batch that stacks only the fields that differ.

Compiling is left to MuJoCo: every row is exactly the model that `mujoco.MjModel.from_xml_string` makes of its rendered
MJCF, derived fields (body_invweight0, dof_M0, stat.meaninertia, ...) included. What a batch stores is one base model
and, for each field in which models of this robot can differ, a stacked float64 array.
"""

import copy
import re
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.robots import Robot

STATISTICS = ("meaninertia", "meanmass", "meansize", "extent", "center")
"""Fields of `MjModel.stat`, called "stat.<name>" in a batch."""

OPTIONS = ("timestep", "gravity", "wind", "density", "viscosity", "impratio", "tolerance", "ls_tolerance")
"""Numeric fields of `MjModel.opt` that a batch can carry, called "opt.<name>"."""

_PROBES = 12
"""Random simulations that are compiled once per robot to learn which fields depend on s, besides the box's corners."""


@dataclass(frozen=True, eq=False)
class Models:
    """L compiled simulations.

    Attributes:
      base: the model of the nominal simulation; it holds every field that does not depend on s.
      leaves: MjModel field -> (L, *field shape) float64, for each field that can depend on s. Always the same names
        for one robot, so that a program compiled for one batch serves all.
    """

    base: mujoco.MjModel
    leaves: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(next(iter(self.leaves.values())))

    def row(self, index: int) -> mujoco.MjModel:
        """A model of its own for one row: a copy of the base model with that row's values filled in."""
        model = copy.copy(self.base)
        for name, values in self.leaves.items():
            _write(model, name, values[index])
        return model


def compile_models(robot: Robot, simulations: ArrayLike) -> Models:
    """Compile one model per simulation and stack what differs.

    Args:
      robot: the robot whose template is rendered.
      simulations: (L, n_s) parameters inside the robot's simulation box.

    Returns:
      The batch. Equal simulations share one compilation, and recent ones are remembered.

    Raises:
      InputError: bad parameters, a template that does not render, or MJCF that MuJoCo does not accept (the message
        names the file and the line).
    """
    values = np.atleast_2d(robot.simulation_box.validate(simulations, "simulations"))
    fields = varying_fields(robot)
    base = base_model(robot)
    rows = [_compiled_row(robot, row.tobytes()) for row in values]
    leaves = {name: np.stack([row[name] for row in rows]) for name in fields}
    return Models(base, leaves)


@lru_cache(maxsize=16)
def base_model(robot: Robot) -> mujoco.MjModel:
    """The compiled model of the nominal simulation (shared: do not edit it)."""
    return compile_mjcf(robot, robot.render(robot.nominal))


@lru_cache(maxsize=16)
def varying_fields(robot: Robot) -> tuple[str, ...]:
    """Names of the MjModel fields that depend on s, found by compiling probes across the box.

    Raises:
      InputError: the models differ in structure (number of bodies, joint types, ...), which one batch cannot hold.
    """
    box = robot.simulation_box
    rng = np.random.default_rng(0)
    probes = [box.low, box.high, *box.sample(rng, _PROBES)]
    base = base_model(robot)
    models = [compile_mjcf(robot, robot.render(probe)) for probe in probes]
    return tuple(name for name in field_names(base) if any(_differ(base, model, name) for model in models))


def field_names(model: mujoco.MjModel) -> list[str]:
    """Every array field of a model, and those of its options and statistics that are numbers."""
    arrays = [name for name in dir(model) if not name.startswith("_") and isinstance(getattr(model, name), np.ndarray)]
    return arrays + [f"opt.{name}" for name in OPTIONS] + [f"stat.{name}" for name in STATISTICS]


def read_field(model: mujoco.MjModel, name: str) -> np.ndarray:
    """One field of a model by its name in a batch, as an array of its own."""
    owner, _, field = name.rpartition(".")
    return np.array(getattr(getattr(model, owner) if owner else model, field))


def compile_mjcf(robot: Robot, xml: str) -> mujoco.MjModel:
    """Compile rendered MJCF.

    Raises:
      InputError: MuJoCo refuses it; the message has the template's name, the line and the line's text.
    """
    try:
        return mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        message = " ".join(str(error).split())
        found = re.search(r"[Ll]ine (?:number=)?(\d+)", message)  # two forms: MuJoCo's own and its XML parser's
        shown = ""
        if found and 0 < int(found[1]) <= len(xml.splitlines()):
            shown = f"; line {found[1]} of the rendered MJCF reads: {xml.splitlines()[int(found[1]) - 1].strip()}"
        raise InputError(f"{robot.template_path}: MuJoCo does not accept the model: {message}{shown}") from None


@lru_cache(maxsize=20_000)
def _compiled_row(robot: Robot, simulation: bytes) -> dict[str, np.ndarray]:
    values = np.frombuffer(simulation)
    model = compile_mjcf(robot, robot.render(values))
    for name, expected in _constant_fields(robot).items():
        if not np.array_equal(read_field(model, name), expected):
            where = dict(zip(robot.simulation_box.names, values.tolist(), strict=True))
            raise InputError(
                f"{robot.template_path}: {name} changes at {where} "
                "but not at the probes across the box; a batch needs fields that depend smoothly on the parameters"
            )
    return {name: read_field(model, name).astype(np.float64) for name in varying_fields(robot)}


@lru_cache(maxsize=16)
def _constant_fields(robot: Robot) -> dict[str, np.ndarray]:
    """The base model's physics fields that must not depend on s (pictures and names are not checked)."""
    base, varying = base_model(robot), varying_fields(robot)
    physics = ("body_", "jnt_", "dof_", "geom_", "actuator_", "eq_", "tendon_", "opt.", "qpos")
    names = (name for name in field_names(base) if name.startswith(physics) and name not in varying)
    return {name: read_field(base, name) for name in names}


def _differ(a: mujoco.MjModel, b: mujoco.MjModel, name: str) -> bool:
    x, y = read_field(a, name), read_field(b, name)
    if x.shape != y.shape:
        raise InputError(
            f"{name} has shape {x.shape} for one simulation and {y.shape} for another: "
            "all simulations of a robot must have the same bodies, joints, geoms and motors"
        )
    return not np.array_equal(x, y)


def _write(model: mujoco.MjModel, name: str, value: np.ndarray) -> None:
    owner, _, field = name.rpartition(".")
    target = getattr(model, owner) if owner else model
    current = getattr(target, field)
    if isinstance(current, np.ndarray):
        current[...] = value
    else:
        setattr(target, field, type(current)(value))
