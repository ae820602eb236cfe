from . import metrics
from .distances import MARKS, fitness_at_marks, multiscale_fitness
from .engine_choice import Engine, EngineSettings
from .evaluation import Evaluation, checked_pairs, evaluate
from .fastest import EngineChoice, choose_engine, fastest_engine
from .fitness import (
    FITNESS_FUNCTIONS,
    FitnessFunction,
    FitnessLike,
    Outcome,
    delta_fitness_of,
    delta_of,
    fitness_function,
    fitness_of,
    learning_performance,
)
from .pair_functions import Trajectory, model_leaves, pair_fitness, pair_trajectory
from .tracked_point import track_configurations

__all__ = [
    "FITNESS_FUNCTIONS",
    "MARKS",
    "Engine",
    "EngineChoice",
    "EngineSettings",
    "Evaluation",
    "FitnessFunction",
    "FitnessLike",
    "Outcome",
    "Trajectory",
    "checked_pairs",
    "choose_engine",
    "delta_fitness_of",
    "delta_of",
    "evaluate",
    "fastest_engine",
    "fitness_at_marks",
    "fitness_function",
    "fitness_of",
    "learning_performance",
    "metrics",
    "model_leaves",
    "multiscale_fitness",
    "pair_fitness",
    "pair_trajectory",
    "track_configurations",
]
