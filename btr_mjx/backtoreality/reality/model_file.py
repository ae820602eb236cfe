"""A reality that is another model file: which numbers it has is read from the file."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.models import PathParameter, base_model, check_robot, compile_mjcf, parse_path, part_names
from btr_mjx.robots import Robot, read_template

_SAME = 1e-6
"""Relative difference of numbers that count as one: they went through the digits of two files."""


def robot_of_file(robot: Robot, model: Path) -> Robot:
    """The robot with the model of another file, whose numbers stand as they are: no edit changes them.

    Raises:
      InputError: the file cannot be used, or has other joints, motors, base, point or keyframe than the robot.
    """
    real = replace(
        robot,
        template=read_template(model),
        template_path=str(model),
        plain=model.suffix != ".j2",
        folder=str(model.parent.resolve()),
        edits=(),
    )
    ours, theirs = compile_mjcf(robot, robot.render(robot.nominal)), base_model(real)
    for kind in ("joint", "actuator"):
        if part_names(ours, kind) != part_names(theirs, kind):
            raise InputError(
                f"reality_model {str(model)!r}: its {kind}s are {', '.join(part_names(theirs, kind))}, expected those "
                f"of {robot.name}: {', '.join(part_names(ours, kind))}"
            )
    if (ours.jnt_type != theirs.jnt_type).any():
        odd = part_names(ours, "joint")[int(np.flatnonzero(ours.jnt_type != theirs.jnt_type)[0])]
        raise InputError(f"reality_model {str(model)!r}: its joint {odd} is of another type than that of {robot.name}")
    check_robot(real)
    return real if variables(real) else replace(real, template=real.render(real.nominal), plain=True)


def variables(real: Robot) -> tuple[str, ...]:
    """Parameters of S on which the text of a reality's model depends; none where it is no template."""
    box, names = real.simulation_box, []
    for i, name in enumerate(box.names):
        rows = np.tile(real.nominal_simulation, (3, 1))
        rows[:, i] = box.low[i], real.nominal[i], box.high[i]
        if len({real.render(row) for row in rows}) > 1:
            names.append(name)
    return tuple(names)


def numbers_of_file(robot: Robot, real: Robot, given: Mapping[str, float]) -> tuple[float, ...]:
    """The parameters of S that a reality's file has, (n_s,); NaN where it does not tell.

    Args:
      robot: the robot of the searches.
      real: that of the file.
      given: values of the variables of the file.
    """
    box, found = robot.simulation_box, dict(given)
    simulation = [given.get(name, value) for name, value in zip(box.names, robot.nominal, strict=True)]
    ours = compile_mjcf(robot, robot.render(robot.nominal))
    theirs = compile_mjcf(real, real.render(simulation))
    for edit in robot.edits:
        if isinstance(edit, PathParameter):
            found[edit.name] = _value(edit, ours, theirs)
    return tuple(found.get(name, np.nan) for name in box.names)


def _value(edit: PathParameter, ours: mujoco.MjModel, theirs: mujoco.MjModel) -> float:
    """The value of a parameter with which our model has the numbers of theirs; NaN if there is none."""
    values = []
    for text in edit.paths:
        try:
            number = parse_path(theirs, text).read(theirs)
        except InputError:
            return np.nan
        own = parse_path(ours, text).read(ours) if edit.relative else 1.0
        values.append(number / own if own else np.nan)
    return values[0] if np.allclose(values, values[0], rtol=_SAME, atol=0.0) else np.nan
