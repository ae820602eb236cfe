from . import cluster, lanes, scan
from .backtoreality import Reality, SimulatedReality
from .coevolve import coevolve
from .errors import InputError
from .evaluation import (
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
from .models import load_robot
from .robots import Box, Robot, hexapod

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
    "cluster",
    "coevolve",
    "evaluate",
    "hexapod",
    "lanes",
    "load_robot",
    "metrics",
    "model_leaves",
    "pair_fitness",
    "pair_trajectory",
    "scan",
]
