"""Batch of models of simulations: one base model and the stacked fields that differ.

Every row equals the model that `mujoco.MjModel.from_xml_string` makes of its rendered MJCF, derived fields
(body_invweight0, dof_M0, stat.meaninertia, ...) included. A batch stores one base model and, for each field in which
models of this robot can differ, a stacked float64 array.

Templates that only do arithmetic are prepared together, without MuJoCo's compiler, by `template_compiler`; all others
are rendered and compiled one by one. Which of the two is used depends on the robot and on the simulation itself only.
"""

import copy
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.models.fields import PHYSICS, field_names, read_field, write_field
from btr_mjx.models.geom_compiler import NotVectorisable
from btr_mjx.models.mjcf_checks import check_mjcf
from btr_mjx.models.model_checks import COMPILE_ERRORS, check_model
from btr_mjx.models.paths import nearest_names
from btr_mjx.models.template_compiler import TemplateCompiler, build_template_compiler
from btr_mjx.robots import Robot
from btr_mjx.runs import read_limited

_PROBES = 12
"""Number of random simulations that are compiled once per robot to find the fields that depend on s."""


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
        names the file and the line).
    """
    values = np.atleast_2d(robot.simulation_box.validate(simulations, "simulations"))
    place: dict[bytes, int] = {}
    index = np.array([place.setdefault(row.tobytes(), len(place)) for row in values])
    distinct = np.frombuffer(b"".join(place)).reshape(len(place), -1)
    compiler, fields = _template_compiler(_model_inputs(robot)), varying_fields(robot)
    if isinstance(compiler, TemplateCompiler):
        leaves, done = compiler.prepare(distinct)
        for i in np.flatnonzero(~done):
            for name, value in _compiled_row(robot, distinct[i].tobytes()).items():
                leaves[name][i] = value
    else:
        rows = [_compiled_row(robot, simulation) for simulation in place]
        leaves = {name: np.stack([row[name] for row in rows]) for name in fields}
    if len(place) < len(values):
        leaves = {name: leaf[index] for name, leaf in leaves.items()}
    return Models(base_model(robot), leaves)


def why_compiled(robot: Robot) -> str:
    """Reason why the models of a robot have to be compiled one by one, which is slow; empty where they do not."""
    compiler = _template_compiler(_model_inputs(robot))
    return "" if isinstance(compiler, TemplateCompiler) else compiler


@lru_cache(maxsize=16)
def _template_compiler(robot: Robot) -> TemplateCompiler | str:
    if robot.edits or robot.folder:
        return "its parameters are edits of the compiled model" if robot.edits else "it includes other files"
    try:
        return build_template_compiler(robot, base_model(robot), varying_fields(robot))
    except NotVectorisable as reason:
        return str(reason)


def _model_inputs(robot: Robot) -> Robot:
    """The robot reduced to what its models depend on, as a key of caches."""
    return replace(robot, name="", duration=1.0, speed_limit=1.0, base_body=None, point="", target=(), keyframe="")


@lru_cache(maxsize=16)
def base_model(robot: Robot) -> mujoco.MjModel:
    """The compiled model of the nominal simulation (shared: do not edit it)."""
    return model_of(robot, robot.nominal_simulation)


def model_of(robot: Robot, simulation: np.ndarray) -> mujoco.MjModel:
    """The model of one simulation (n_s,): its rendered MJCF, compiled, with the robot's edits.

    Raises:
      InputError: a template that does not render, MJCF that MuJoCo does not accept, a number that cannot be set.
    """
    return general_model(robot, simulation) if robot.edits else compile_mjcf(robot, robot.render(simulation))


def general_model(robot: Robot, simulation: np.ndarray) -> mujoco.MjModel:
    """The same, compiled without MuJoCo's short cut for bodies of simple inertia, so that any edit is possible."""
    model = copy.copy(_general_text(_model_inputs(replace(robot, edits=())), robot.render(simulation)))
    for edit in robot.edits:
        index = [robot.simulation_box.index(name) for name in edit.parameters]
        edit(model, simulation[index].tolist())
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


@lru_cache(maxsize=16)
def _general_text(robot: Robot, text: str) -> mujoco.MjModel:
    return compile_mjcf(robot, text, general=True)


@lru_cache(maxsize=16)
def varying_fields(robot: Robot) -> tuple[str, ...]:
    """Names of the MjModel fields that depend on s, found by compiling simulations across the box.

    Raises:
      InputError: the models differ in structure (number of bodies, joint types, ...), which one batch cannot hold.
    """
    box = robot.simulation_box
    rng = np.random.default_rng(0)
    probes = [box.low, box.high, *box.sample(rng, _PROBES)]
    base = base_model(robot)
    models = [model_of(robot, probe) for probe in probes]
    found = tuple(name for name in field_names(base) if any(_differ(base, model, name) for model in models))
    if not found and robot.simulator is None:
        raise InputError(f"{robot.template_path}: the model is the same for all of {', '.join(box.names)}")
    return found or ("qpos0",)  # a batch holds at least one field


def start_of(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The state in which trials start: qpos (nq,), qvel (nv,) and act (na,); None for the model's qpos0 at rest.

    Raises:
      InputError: a keyframe that the model does not have.
    """
    if not robot.keyframe:
        return None
    model = base_model(robot)
    names = [model.key(i).name for i in range(model.nkey)]
    if robot.keyframe not in names:
        raise InputError(f"keyframe {robot.keyframe!r}: the model has {nearest_names(robot.keyframe, names)}")
    i = names.index(robot.keyframe)
    return model.key_qpos[i].copy(), model.key_qvel[i].copy(), model.key_act[i].copy()


def compile_mjcf(robot: Robot, xml: str, general: bool = False) -> mujoco.MjModel:
    """Compile rendered MJCF.

    Args:
      robot: for the folder of included files, and for messages.
      xml: the rendered text.
      general: no body counts as simple.

    Raises:
      InputError: MuJoCo rejects it; the message has the template's name, the line number and the line's text.
    """
    check_mjcf(xml, robot.template_path, Path(robot.folder or "."))
    try:
        if not robot.folder and not general:
            return _checked(mujoco.MjModel.from_xml_string(xml), robot)
        spec = mjcf_spec(robot, xml)
        if general:
            for body in spec.bodies:
                body.simple = 0
        return _checked(spec.compile(), robot)
    except InputError:
        raise
    except COMPILE_ERRORS as error:
        message = " ".join(str(error).split())
        found = re.search(r"[Ll]ine (?:number=)?(\d+)", message)  # two forms: MuJoCo's own and its XML parser's
        shown = ""
        if found and 0 < int(found[1]) <= len(xml.splitlines()):
            shown = f"; line {found[1]} of the rendered MJCF reads: {xml.splitlines()[int(found[1]) - 1].strip()}"
        raise InputError(f"{robot.template_path}: MuJoCo does not accept the model: {message}{shown}") from None


def mjcf_spec(robot: Robot, xml: str) -> mujoco.MjSpec:
    """The specification of rendered MJCF, with the files that it includes.

    Raises:
      ValueError: MuJoCo rejects it.
    """
    spec = mujoco.MjSpec.from_string(xml, include=_included_files(Path(robot.folder or "."), xml))
    spec.modelfiledir = robot.folder
    return spec


def _checked(model: mujoco.MjModel, robot: Robot) -> mujoco.MjModel:
    """The model, whose numbers can be simulated."""
    check_model(model, robot.template_path)
    return model


def _included_files(folder: Path, xml: str) -> dict[str, bytes]:
    """Contents of the files that MJCF includes, and of those that these include, by the names it uses for them."""
    found: dict[str, bytes] = {}
    left = [xml]
    while left:
        for name in re.findall(r"<include[^>]*\sfile\s*=\s*[\"']([^\"']+)[\"']", left.pop()):
            if name not in found and (folder / name).is_file():
                found[name] = read_limited(folder / name)
                left.append(found[name].decode("utf-8", "replace"))
    return found


@lru_cache(maxsize=20_000)
def _compiled_row(robot: Robot, simulation: bytes) -> dict[str, np.ndarray]:
    values = np.frombuffer(simulation)
    model = model_of(robot, values)
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
    """The base model's physics fields that must not depend on s (visual fields and names are not checked)."""
    base, varying = base_model(robot), varying_fields(robot)
    names = (name for name in field_names(base) if name.startswith(PHYSICS) and name not in varying)
    return {name: read_field(base, name) for name in names}


def _differ(a: mujoco.MjModel, b: mujoco.MjModel, name: str) -> bool:
    x, y = read_field(a, name), read_field(b, name)
    if x.shape != y.shape:
        raise InputError(
            f"{name} has shape {x.shape} for one simulation and {y.shape} for another: "
            "all simulations of a robot must have the same bodies, joints, geoms and motors"
        )
    return not np.array_equal(x, y)
