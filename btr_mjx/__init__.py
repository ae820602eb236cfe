"""Back-to-Reality on batched MuJoCo: co-evolve a robot's controller and its simulation.

import btr_mjx as btr

robot = btr.hexapod()
evaluation = btr.evaluate(robot, simulations, controllers)     # fitness (L, M)
btr.scan.delta_fitness(robot, simulations, controllers, f_r)   # (L,)
btr.coevolve(preset="quick", out="runs/demo")                  # a whole run, as the command does it
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from btr_mjx import coevolve, metrics, scan
    from btr_mjx.behaviour import EngineSettings, Evaluation, evaluate
    from btr_mjx.errors import InputError
    from btr_mjx.fitness import FitnessFunction, Outcome
    from btr_mjx.pairs import Trajectory, model_leaves, pair_fitness, pair_trajectory
    from btr_mjx.reality import Reality, SimulatedReality
    from btr_mjx.robots import Robot, hexapod
    from btr_mjx.spaces import Box

_HOME = {
    "Box": "spaces",
    "EngineSettings": "behaviour",
    "Evaluation": "behaviour",
    "FitnessFunction": "fitness",
    "InputError": "errors",
    "Outcome": "fitness",
    "Reality": "reality",
    "Robot": "robots",
    "SimulatedReality": "reality",
    "Trajectory": "pairs",
    "evaluate": "behaviour",
    "hexapod": "robots",
    "model_leaves": "pairs",
    "pair_fitness": "pairs",
    "pair_trajectory": "pairs",
}
_MODULES = ("coevolve", "metrics", "scan")

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
    """Load a public name on first use: importing the package costs nothing, and `python -m` runs each module once."""
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{name}")
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
