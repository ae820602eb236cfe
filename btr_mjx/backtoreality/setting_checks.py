"""Checks of a command's settings, before anything is computed or written."""

import math
from collections.abc import Mapping
from typing import Any

from btr_mjx.errors import InputError
from btr_mjx.models import check_robot
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
