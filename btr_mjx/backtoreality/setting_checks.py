"""Checks of a command's settings, before anything is computed or written."""

import math
import numbers
from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from btr_mjx.errors import InputError
from btr_mjx.models import check_robot, nearest_names
from btr_mjx.robots import Robot

MAX_PAIRS = 10**9
"""Most simulated trials of a run; at a million steps a second that are decades."""

MAX_POPULATION = 1_000_000
"""Largest population, number of trials or points of a grid: each is held in memory."""

_RANGES: Mapping[str, tuple[float, float]] = {
    "seed": (0, 2**63 - 1),
    "grid": (2, MAX_POPULATION),
    **dict.fromkeys(("trials", "controllers", "simulations"), (1, MAX_POPULATION)),
    **dict.fromkeys(("iterations", "generations", "controller_generations", "simulation_generations"), (1, 10**6)),
    "max_evaluations": (1, 2**63 - 1),
    "max_effects": (0, 100),
    **dict.fromkeys(("controller_bits", "simulation_bits"), (1, 32)),
    **dict.fromkeys(("p_m", "simulation_p_m"), (0, 1)),
    "noise": (0, 1000),
    "target_delta": (0, 1e12),
    "signal_rate": (1, 1e5),
    "duration": (1e-6, 1e6),
}
"""Smallest and largest value of a setting, by its name; a setting that is None is not checked."""


def check_settings(config: Any, robot: Robot) -> None:
    """Check the numbers of a command's config, and that its robot can be tried.

    Args:
      config: a dataclass with some of the settings of `_RANGES`.
      robot: the robot.

    Raises:
      InputError: a number outside its range, more trials than `MAX_PAIRS`, or see `check_robot`.
    """
    for name, (low, high) in _RANGES.items():
        value = getattr(config, name, None)
        if value is not None and not low <= value <= high:
            raise InputError(f"{name}: got {_short(value)}, expected a value within [{low:.10g}, {high:.10g}]")
    for mark in getattr(config, "marks", ()):
        if not (math.isfinite(mark) and mark > 0):
            raise InputError(f"marks: got {mark}, expected times in seconds above 0")
    pairs = _pairs(config)
    if pairs > MAX_PAIRS:
        raise InputError(f"these settings ask for {_short(pairs)} simulated trials, at most {MAX_PAIRS:.3g} are run")
    check_robot(robot)


def _pairs(config: Any) -> int:
    """Trials that the settings ask for, at most."""

    def value(name: str) -> int:
        return int(getattr(config, name, None) or 0)

    if hasattr(config, "grid"):
        return value("controllers") * value("generations") + value("trials") * (value("grid") + 1)
    step_1 = value("controllers") * value("controller_generations")
    step_3 = value("simulations") * value("simulation_generations") * value("trials") * value("iterations")
    return value("iterations") * (step_1 + step_3)


def _short(value: float) -> str:
    return f"{value:.6g}" if abs(value) >= 1e15 else f"{value!r}"


def typed_settings(config: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that were given in Python, as a command line would give them.

    Args:
      config: a flat dataclass of bools, numbers, texts, choices, paths and tuples of these.
      given: some of its fields; a text may stand for a path, and one value or a list for a tuple.

    Returns:
      The same with the types of the fields.

    Raises:
      InputError: a name that is no field, a value of another type, or none of the choices.
    """
    hints = get_type_hints(config)
    for name in given:
        if name not in hints:
            raise InputError(f"there is no setting {name!r}; nearest: {nearest_names(name, [*hints])}")
    return {name: _typed(name, value, hints[name]) for name, value in given.items()}


def _typed(name: str, value: Any, hint: Any) -> Any:
    """A value as one of the types of a field."""
    kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    for kind in kinds:
        inner = get_args(kind)
        if get_origin(kind) is tuple and isinstance(value, (list, tuple, str)):
            return tuple(_typed(name, one, inner[0]) for one in ([value] if isinstance(value, str) else value))
        if get_origin(kind) is Literal and isinstance(value, str) and value in inner:
            return value
        if kind is Path and isinstance(value, (str, Path)):
            return Path(value)
        number = {int: numbers.Integral, float: numbers.Real}.get(kind)
        if number is not None and isinstance(value, number) and not isinstance(value, bool):
            return kind(value)
        if kind in (bool, str, type(None)) and isinstance(value, kind):
            return value
    words = " or ".join(", ".join(map(repr, get_args(k))) if get_origin(k) is Literal else _kind(k) for k in kinds)
    raise InputError(f"{name}: got {value!r}, expected {words}")


def _kind(kind: Any) -> str:
    """A type in words."""
    known = {int: "a whole number", float: "a number", bool: "True or False", str: "a text", Path: "a path"}
    return f"a tuple of {get_args(kind)[0].__name__}" if get_origin(kind) is tuple else known.get(kind, "None")
