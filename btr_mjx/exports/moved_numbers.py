"""Numbers of a compiled model that one parameter moves, found by comparing the models at both ends of its interval."""

from collections.abc import Mapping

import mujoco
import numpy as np

from btr_mjx.models import model_of, read_field
from btr_mjx.robots import Robot

Ends = Mapping[str, tuple[float, float]]
"""Path of a number (`models.parse_path`) -> its values where a parameter is at the low and the high end."""

_PREFIXES = ("body_", "jnt_", "dof_", "geom_", "site_", "actuator_", "tendon_", "eq_", "pair_", "qpos")
_OPTIONS = ("gravity", "wind", "density", "viscosity", "impratio")
_NO_PHYSICS = ("_user", "_rgba")

LINEARITY = 0.25
"""Accepted deviation of a number from the straight line between its ends [share of their distance]."""


ROUNDING = 1e-9
"""Differences below this share of a field's largest number are rounding errors of the compiler."""


def field_ends(low: mujoco.MjModel, high: mujoco.MjModel) -> dict[str, tuple[float, float]]:
    """Numbers in which two models of the same structure differ by more than rounding, derived constants included.

    Returns:
      Values at both ends by path: `option/density`, `dof_damping[3]`, `geom_friction[2][0]`.
    """
    found = {}
    for name in _fields(low):
        a, b = np.atleast_1d(read_field(low, name)), np.atleast_1d(read_field(high, name))
        rounding = ROUNDING * max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
        for index in zip(*np.nonzero(np.abs(a - b) > rounding), strict=True):
            found[_path(name, a.size, index)] = (float(a[index]), float(b[index]))
    return found


def is_linear(ends: Ends, share: float, low: mujoco.MjModel, between: mujoco.MjModel) -> bool:
    """Whether a model at a share in [0, 1] between both ends is near the straight line, unlike numbers that jump."""
    actual = {path: b for path, (_, b) in field_ends(low, between).items()}
    return all(
        abs(a + share * (b - a) - actual.get(path, a)) <= LINEARITY * abs(b - a) for path, (a, b) in ends.items()
    )


def robot_ends(
    robot: Robot, simulation: Mapping[str, float], name: str, low: float, high: float
) -> dict[str, tuple[float, float]]:
    """Numbers of a robot's model that one of its parameters moves.

    Args:
      robot: the robot.
      simulation: values of its parameters; those that are not named are nominal.
      name: the parameter.
      low: lower end of its interval.
      high: upper end; both inside the robot's simulation box.

    Returns:
      See `field_ends`; empty where the model in the middle is not near the straight line, see `is_linear`.

    Raises:
      InputError: an unknown parameter, values outside the box, or a model that cannot be built.
    """
    box = robot.simulation_box
    values = np.array(robot.nominal_simulation, float)
    for other, value in simulation.items():
        values[box.indices([other])] = value
    models = []
    for value in (low, high, 0.5 * (low + high)):
        values[box.indices([name])] = value
        models.append(model_of(robot, box.validate(values, "simulation")))
    ends = field_ends(models[0], models[1])
    return ends if is_linear(ends, 0.5, models[0], models[2]) else {}


def _fields(model: mujoco.MjModel) -> list[str]:
    arrays = [
        name
        for name in dir(model)
        if name.startswith(_PREFIXES) and not name.endswith(_NO_PHYSICS)
        if isinstance(value := getattr(model, name), np.ndarray) and value.dtype.kind == "f"
    ]
    return arrays + [f"opt.{name}" for name in _OPTIONS]


def _path(name: str, size: int, index: tuple[int, ...]) -> str:
    place = "".join(f"[{i}]" for i in index)
    if name.startswith("opt."):
        return f"option/{name.removeprefix('opt.')}{place if size > 1 else ''}"
    return f"{name}{place}"
