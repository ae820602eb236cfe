"""A robot from one file: `load_robot("robot.toml")`.

    model = "robot.xml"            # MJCF, or a Jinja2 template (robot.xml.j2)
    base_body = "trunk"            # or point = "hand" for a robot with a fixed base
    duration = 2.0
    keyframe = "home"

    [[parameter]]                  # a dimension of the space of simulations
    name = "knee damping"
    path = ["joint:left_knee/damping", "joint:right_knee/damping"]
    bounds = [0.0, 2.0]

    [controller]
    signal = "sinusoid"
    frequency = 1.5

docs/robot_file.md has all keys.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.models.compilation import base_model, start_of
from btr_mjx.models.controller_table import controls_at_start, read_controller
from btr_mjx.models.path_parameters import KEYS, PathParameter, read_bounds, read_path_parameter
from btr_mjx.models.paths import nearest_names, refuse_unknown_keys
from btr_mjx.models.robot_checks import free_joints
from btr_mjx.robots import Box, Robot, Sinusoids, hexapod, read_template
from btr_mjx.runs import file_name, is_number, naming_lines, read_toml, toml_rows, toml_section

_KEYS = ("name", "model", "base_body", "point", "duration", "keyframe", "fitness", "target", "speed_limit")
_TABLES = ("parameter", "controller", "constants")


def load_robot(path: str | Path) -> Robot:
    """The robot that a robot.toml describes.

    Args:
      path: the file, or a folder that holds a robot.toml.

    Returns:
      The robot.

    Raises:
      InputError: the file cannot be read, has an unknown key, or does not fit the model; the message names the place.
    """
    file = Path(path)
    file = file / "robot.toml" if file.is_dir() else file
    if file.suffix in (".xml", ".mjcf", ".j2"):
        raise InputError(f"{file}: a robot is a robot.toml, which names its MJCF; see docs/robot_file.md")
    with naming_lines(file):
        return _load_robot(file)


def _load_robot(file: Path) -> Robot:
    try:
        table = read_toml(file)
    except OSError as error:
        raise InputError(f"robot {str(file)!r} cannot be read: {error}") from None
    refuse_unknown_keys(table, (*_KEYS, *_TABLES), str(file))
    source = file.parent / file_name(table, "model", str(file))
    plain = source.suffix != ".j2"
    rows = toml_rows(table, "parameter", file)
    if not rows:
        raise InputError(f"{file}: there is no [[parameter]]; name at least one unknown number of the model")
    text, number = _of(table, str, "a text", file), _of(table, (int, float), "a number", file)
    known = [_template_parameter(row, plain, source, file) for row in rows if "path" not in row]
    draft = Robot(
        name="draft",
        template=read_template(source),
        template_path=str(source),
        simulation_box=_box(known or [_Parameter("none", 0.0, 1.0, 0.0, "")]),
        controller_box=Box(["none"], 0.0, 1.0),
        signal=Sinusoids((), (), (), -1, 1.0, (), (), ()),
        nominal=tuple(p.nominal for p in known) or (0.0,),
        constants=_constants(table, file),
        folder=str(source.parent.resolve()),
        plain=plain,
    )
    model = base_model(draft)
    parameters = [_parameter(known, row, f"{file}: [[parameter]] {i}", model) for i, row in enumerate(rows, 1)]
    robot = replace(
        draft,
        name=text("name", file.parent.resolve().name if file.stem == "robot" else file.stem),
        simulation_box=_box(parameters),
        nominal=tuple(p.nominal for p in parameters),
        base_body=_checked_base(model, text("base_body", ""), text("point", ""), file),
        edits=tuple(p.edit for p in parameters if p.edit is not None),
        keyframe=text("keyframe", ""),
        point=text("point", ""),
        fitness=_fitness(text("fitness", "distance"), file),
        target=_target(table.get("target", []), file),
        duration=float(number("duration", 1.7)),
        speed_limit=float(number("speed_limit", 50.0)),
    )
    if not robot.speed_limit > 0:
        raise InputError(f"{file}: speed_limit = {robot.speed_limit}: expected a speed above 0 [m/s]")
    try:
        start_of(robot)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    _check_start(robot)
    controls = controls_at_start(model, robot.keyframe)
    box, signal = read_controller(toml_section(table, "controller", file), model, controls, robot.duration, file)
    return replace(robot, controller_box=box, signal=signal)


def chosen_robot(robot: Path | None, template: Path | None, duration: float | None) -> Robot:
    """The robot of a command: that of a robot.toml, the hexapod, or the hexapod with another template.

    The duration T_e [s] is the robot's own by default.

    Raises:
      InputError: both files are given, a file that cannot be read or does not fit, a duration that is not positive.
    """
    if robot is None:
        found = hexapod()
        if template is not None:
            found = replace(found, template=read_template(template), template_path=str(template))
    elif template is not None:
        raise InputError("--robot and --template: got both; a robot.toml names its own template (model = ...)")
    else:
        found = load_robot(robot)
    return found if duration is None else replace(found, duration=duration)


@dataclass(frozen=True)
class _Parameter:
    name: str
    low: float
    high: float
    nominal: float
    unit: str
    edit: PathParameter | None = None


def _box(parameters: Sequence[_Parameter]) -> Box:
    names, low, high, units = zip(*((p.name, p.low, p.high, p.unit) for p in parameters), strict=True)
    return Box(names, low, high, units=units)


def _template_parameter(row: Mapping[str, Any], plain: bool, source: Path, file: Path) -> _Parameter:
    """A parameter that is a variable of the template."""
    where = f"{file}: [[parameter]] {row.get('name', '')}".rstrip()
    refuse_unknown_keys(row, ("name", "bounds", "low", "high", "unit", "nominal", "path"), where)
    if plain:
        raise InputError(f'{where}: no path, and {source.name} is no template; add path = "..."')
    low, high = read_bounds(row, where)
    nominal = row.get("nominal", (low + high) / 2)
    if not is_number(nominal) or not isinstance(row.get("name"), str):
        raise InputError(f'{where}: expected name = "..." and a number for nominal, got {nominal!r}')
    return _Parameter(row["name"], low, high, float(nominal), str(row.get("unit", "")))


def _parameter(known: Sequence[_Parameter], row: Mapping[str, Any], where: str, model: mujoco.MjModel) -> _Parameter:
    if "path" not in row:
        return next(p for p in known if p.name == row["name"])
    notes = list[str]()
    edit = read_path_parameter(row, model, where, notes, ("nominal",))
    if notes:
        raise InputError(f"{notes[0].replace(' was ignored', '')}; valid keys: {', '.join((*KEYS, 'nominal'))}")
    nominal = row.get("nominal", edit.value(model))
    if not is_number(nominal):
        raise InputError(f"{where}: nominal = {nominal!r}: expected a number")
    return _Parameter(edit.name, edit.low, edit.high, float(nominal), edit.unit, edit)


def _constants(table: Mapping[str, Any], file: Path) -> tuple[tuple[str, float], ...]:
    """The numbers of [constants] that a template needs beside its parameters."""
    given = table.get("constants", {})
    if not isinstance(given, Mapping) or not all(is_number(value) for value in given.values()):
        raise InputError(f"{file}: [constants]: expected NAME = NUMBER, got {given!r}")
    return tuple((name, float(value)) for name, value in given.items())


def _of(table: Mapping[str, Any], kind: Any, words: str, file: Path) -> Any:
    """Reads entries of one kind."""

    def get(key: str, default: Any) -> Any:
        value = table.get(key, default)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise InputError(f"{file}: {key} = {value!r}: expected {words}")
        return value

    return get


def _fitness(name: str, file: Path) -> str:
    """A fitness function's name; a file of one's own is looked for beside robot.toml."""
    if ".py:" not in name:
        return name
    own, _, attribute = name.rpartition(":")
    return f"{(file.parent / own).resolve()}:{attribute}"


def _target(value: Any, file: Path) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) not in (0, 3) or not all(is_number(v) for v in value):
        raise InputError(f"{file}: target = {value!r}: expected [x, y, z] in metres")
    return tuple(float(v) for v in value)


def _checked_base(model: mujoco.MjModel, base: str, point: str, file: Path) -> str | None:
    """The base body; a robot that is bolted down needs a point instead, or its fitness would always be 0."""
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    free = [*free_joints(model)]
    if base and base not in free:
        if base in bodies:
            raise InputError(
                f"{file}: base_body = {base!r}: this body has no free joint; for a planar robot (slide joints) and for "
                f"one that is bolted down write point = {base!r} instead; bodies with a free joint: "
                f"{', '.join(free) or 'none'}"
            )
        near = nearest_names(base, free or bodies)
        raise InputError(f"{file}: base_body = {base!r}: expected a body with a free joint; nearest: {near}")
    if base or point:
        return base or None
    if len(free) != 1:
        raise InputError(
            f'{file}: neither base_body nor point is given: write base_body = "..." for the body that moves freely '
            f'({", ".join(free) or "this model has none"}), or point = "..." for the site or body whose position counts'
        )
    return free[0]


def _check_start(robot: Robot) -> None:
    """Raise InputError where the model does not survive its first tenth of a second at rest."""
    model, start = base_model(robot), start_of(robot)
    data = mujoco.MjData(model)
    if start is not None:
        data.qpos[:], data.qvel[:], data.act[:] = start
    for _ in range(max(1, int(0.1 / model.opt.timestep))):
        mujoco.mj_step(model, data)
        if not np.isfinite(data.qacc).all() or any(data.warning[i].number for i in _UNSTABLE):
            raise InputError(
                f"{robot.template_path}: the simulation becomes unstable within {data.time:.4g} s of its start, at a "
                f"time step of {model.opt.timestep:g} s; choose a smaller one or another keyframe"
            )


_UNSTABLE = tuple(
    int(kind)
    for kind in (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
)
