"""Back-to-Reality on batched MuJoCo: co-evolve a robot's controller and its simulation.

import btr_mjx as btr

robot = btr.Robot(...)                                         # or btr.hexapod(), the robot of the paper
evaluation = btr.evaluate(robot, simulations, controllers)     # fitness (L, M)
btr.scan.delta_fitness(robot, simulations, controllers, f_r)   # (L,)
btr.coevolve(preset="quick", out="runs/demo")                  # a complete run, as the command does it
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from btr_mjx import coevolve, scan
    from btr_mjx.backtoreality import Reality, SimulatedReality
    from btr_mjx.errors import InputError
    from btr_mjx.evaluation import (
        EngineSettings,
        Evaluation,
        FitnessFunction,
        Outcome,
        Trajectory,
        evaluate,
        metrics,
        model_leaves,
        pair_fitness,
        pair_trajectory,
    )
    from btr_mjx.robots import Box, Robot, hexapod

_HOME = {
    "Box": "robots",
    "EngineSettings": "evaluation",
    "Evaluation": "evaluation",
    "FitnessFunction": "evaluation",
    "InputError": "errors",
    "Outcome": "evaluation",
    "Reality": "backtoreality",
    "Robot": "robots",
    "SimulatedReality": "backtoreality",
    "Trajectory": "evaluation",
    "evaluate": "evaluation",
    "hexapod": "robots",
    "model_leaves": "evaluation",
    "pair_fitness": "evaluation",
    "pair_trajectory": "evaluation",
}
"""Public name -> room that exports it."""

_MODULES = {"coevolve": "coevolve", "metrics": "evaluation.metrics", "scan": "scan"}
"""Public name -> module."""

__all__ = [
    "Box",
    "EngineSettings",
    "Evaluation",
    "FitnessFunction",
    "InputError",
    "Outcome",
    "Reality",
    "Robot",
    "SimulatedReality",
    "Trajectory",
    "coevolve",
    "evaluate",
    "hexapod",
    "metrics",
    "model_leaves",
    "pair_fitness",
    "pair_trajectory",
    "scan",
]


def __getattr__(name: str) -> Any:
    """Load a public name on first use, so that importing the package is fast and `python -m` loads each module once."""
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{_MODULES[name]}")
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
