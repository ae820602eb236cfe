"""Batch of models of simulations: one base model and the stacked fields that differ.

Every row equals the model that MuJoCo compiles from its rendered MJCF, derived fields (body_invweight0, dof_M0,
stat.meaninertia, ...) included. A batch stores one base model and, for each field in which models of this robot can
differ, a stacked float64 array.

Simulations that render to the same MJCF share one compiled model, whose numbers are edited for each of them; derived
fields follow (mj_setConst), except `MjModel.stat`. Different MJCF is compiled on threads: MuJoCo's compiler runs beside
Python. A row depends on its own simulation only, to the bit.
"""

import copy
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.models.compilation import base_model, compile_mjcf, editor_of, model_of, unedited_model
from btr_mjx.models.model_fields import PHYSICS, field_names, read_field, write_field
from btr_mjx.robots import Robot
from btr_mjx.runs import available_cores

_PROBES = 12
"""Number of random simulations that are compiled once per robot to find the fields that depend on s."""

_KEPT_ROWS = 256
"""Batches of at most so many simulations are kept for the next calls, as neighbouring tiles of a scan share theirs."""

_HIERARCHY = ("bvh_child", "bvh_depth", "bvh_nodeid")
"""Trees of bounding volumes, those of bodies first. Any tree over the same geoms is valid: all rows have the base
model's, since a batch of MuJoCo (`mujoco.batch`) has one for all of its models."""


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
        """The model of one row: a copy of the base model with that row's values."""
        model = copy.copy(self.base)
        for name, values in self.leaves.items():
            write_field(model, name, values[index])
        return model


def compile_models(robot: Robot, simulations: ArrayLike) -> Models:
    """Models of simulations, with the fields that differ stacked.

    Args:
      robot: the robot whose template is rendered.
      simulations: (L, n_s) parameters inside the robot's simulation box.

    Returns:
      The batch. Equal simulations are prepared once. A row depends on its own simulation only, to the bit.

    Raises:
      InputError: bad parameters, a template that does not render, or MJCF that MuJoCo does not accept (the message
        names the file, the line and the parameters).
    """
    values = np.atleast_2d(robot.simulation_box.validate(simulations, "simulations"))
    index = _equal_rows(values)
    distinct = values[np.unique(index, return_index=True)[1]]
    if len(distinct) > _KEPT_ROWS:
        leaves = _prepared(robot, distinct)
    else:
        leaves = _kept(robot, distinct.tobytes())
    return Models(base_model(robot), {name: leaf[index] for name, leaf in leaves.items()})


@lru_cache(maxsize=8)
def _kept(robot: Robot, simulations: bytes) -> dict[str, np.ndarray]:
    return _prepared(robot, np.frombuffer(simulations).reshape(-1, robot.simulation_box.n))


def _prepared(robot: Robot, simulations: np.ndarray) -> dict[str, np.ndarray]:
    """Field -> (L, *field shape) of simulations (L, n_s)."""
    base = base_model(robot)
    constants = _constant_names(robot)
    read = attrgetter(*constants)
    expected = _values(base, read)
    leaves = {name: np.empty((len(simulations), *read_field(base, name).shape)) for name in varying_fields(robot)}

    def prepare(rows: np.ndarray) -> None:
        for row, model in _models(robot, simulations, rows):
            if _values(model, read) != expected:
                with _named(robot, simulations[row]):
                    _refuse_change(robot, model, constants)
            for name, leaf in leaves.items():
                leaf[row] = read_field(model, name)

    with ThreadPoolExecutor(available_cores()) as threads:
        for _ in threads.map(prepare, _same_text(robot, simulations)):
            pass  # raises the error of the first simulation that has one
    return leaves


def _equal_rows(values: np.ndarray) -> np.ndarray:
    """For each row (L,) the number of its value; values are numbered as they appear, and equal to the bit."""
    numbers: dict[bytes, int] = {}
    return np.array([numbers.setdefault(row.tobytes(), len(numbers)) for row in values])


def _same_text(robot: Robot, simulations: np.ndarray) -> list[np.ndarray]:
    """Groups of rows that render to the same MJCF."""
    edited = {name for edit in robot.edits for name in edit.parameters}
    rendered = [name not in edited for name in robot.simulation_box.names]
    group = _equal_rows(simulations[:, rendered])
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


def _models(robot: Robot, simulations: np.ndarray, rows: np.ndarray) -> Iterator[tuple[int, mujoco.MjModel]]:
    """Rows that render to the same MJCF with their models, each of which is valid until the next one is asked for."""
    first = simulations[rows[0]]
    with _named(robot, first):
        text = robot.render(first)
        model = copy.copy(unedited_model(robot, text)) if robot.edits else compile_mjcf(robot, text)
    _share_hierarchy(model, base_model(robot))
    if not robot.edits:  # its rows differ, and so do their texts
        yield rows[0], model
        return
    edit = editor_of(robot, model)
    compiled = {name: read_field(model, name) for name in varying_fields(robot)}
    for row in rows:
        for name, value in compiled.items():
            write_field(model, name, value)
        with _named(robot, simulations[row]):
            edit(model, simulations[row])
        yield row, model


def _share_hierarchy(model: mujoco.MjModel, base: mujoco.MjModel) -> None:
    """Give a model's bodies the base model's trees of bounding volumes, with boxes that fit."""
    bodies = slice(_bodies_volumes(base))
    trees = [(getattr(model, name)[bodies], getattr(base, name)[bodies]) for name in _HIERARCHY]
    if model.nbvh != base.nbvh or all(np.array_equal(own, shared) for own, shared in trees):
        return
    for own, shared in trees:
        own[:] = shared
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _bodies_volumes(model: mujoco.MjModel) -> int:
    """Number of bounding volumes of bodies; those of meshes follow."""
    return int(model.body_bvhnum.sum())


@contextmanager
def _named(robot: Robot, simulation: np.ndarray) -> Iterator[None]:
    """Errors of input also say in which simulation they arise."""
    try:
        yield
    except InputError as error:
        pairs = zip(robot.simulation_box.names, simulation.tolist(), strict=True)
        raise InputError(f"{error} (at {', '.join(f'{name} = {value:.6g}' for name, value in pairs)})") from None


@lru_cache(maxsize=16)
def varying_fields(robot: Robot) -> tuple[str, ...]:
    """Names of the MjModel fields that depend on s, found by compiling simulations across the box.

    Raises:
      InputError: the models differ in structure (number of bodies, joint types, ...), which one batch cannot hold.
    """
    box, base = robot.simulation_box, base_model(robot)
    models = []
    for probe in (box.low, box.high, *box.sample(np.random.default_rng(0), _PROBES)):
        with _named(robot, probe):
            models.append(model_of(robot, probe))
    differing = {name for name in field_names(base) if any(_differ(base, model, name) for model in models)}
    if "body_inertia" in differing:
        differing.add("body_iquat")  # principal axes may turn between the probes
    found = tuple(name for name in field_names(base) if name in differing)
    fixed = robot.plain and not robot.edits  # no parameter can change it, nor does anything say that one does
    if not found and robot.simulator is None and not fixed:
        raise InputError(f"{robot.template_path}: the model is the same for all of {', '.join(box.names)}")
    return found or ("qpos0",)  # a batch holds at least one field


def _differ(a: mujoco.MjModel, b: mujoco.MjModel, name: str) -> bool:
    x, y = read_field(a, name), read_field(b, name)
    if x.shape != y.shape:
        raise InputError(
            f"{name} has shape {x.shape} for one simulation and {y.shape} for another: "
            "all simulations of a robot must have the same bodies, joints, geoms and motors"
        )
    if name in _HIERARCHY:
        x, y = x[_bodies_volumes(a) :], y[_bodies_volumes(a) :]
    return not np.array_equal(x, y)


@lru_cache(maxsize=16)
def _constant_names(robot: Robot) -> list[str]:
    """The physics fields that must not depend on s (visual fields and names are not checked)."""
    base, varying = base_model(robot), varying_fields(robot)
    return [name for name in field_names(base) if name.startswith(PHYSICS) and name not in varying]


def _values(model: mujoco.MjModel, read: attrgetter) -> list[bytes | float]:
    return [value.tobytes() if isinstance(value, np.ndarray) else value for value in read(model)]


def _refuse_change(robot: Robot, model: mujoco.MjModel, constants: Sequence[str]) -> None:
    """Raise InputError where a field that must not depend on s is not the base model's."""
    for name in constants:
        if not np.array_equal(read_field(model, name), read_field(base_model(robot), name)):
            raise InputError(
                f"{robot.template_path}: {name} changes here, but not at the probes across the box; a batch needs "
                "fields that depend smoothly on the parameters"
            )
