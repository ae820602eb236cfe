"""Evaluation of pairs (s, c): behaviour and fitness, on which everything else is built.

`evaluate` maps (L, n_s) simulations and (M, n_c) controllers to an `Evaluation` with fitness (L, M). `pair_fitness` is
a function of one pair for JAX. Fitness functions, delta_k, Delta_fitness, distances and `metrics` belong here, too.
"""

from btr_mjx.evaluation import metrics
from btr_mjx.evaluation.distances import MARKS, fitness_at_marks, multiscale_fitness
from btr_mjx.evaluation.evaluation import Engine, EngineSettings, Evaluation, base_address, evaluate
from btr_mjx.evaluation.fitness import (
    DISTANCE,
    FITNESS_FUNCTIONS,
    FitnessFunction,
    Outcome,
    delta_fitness_of,
    delta_of,
    fitness_function,
    learning_performance,
)
from btr_mjx.evaluation.foot_forces import foot_bodies, foot_forces
from btr_mjx.evaluation.pair_functions import Trajectory, model_leaves, pair_fitness, pair_trajectory

__all__ = [
    "DISTANCE",
    "FITNESS_FUNCTIONS",
    "MARKS",
    "Engine",
    "EngineSettings",
    "Evaluation",
    "FitnessFunction",
    "Outcome",
    "Trajectory",
    "base_address",
    "delta_fitness_of",
    "delta_of",
    "evaluate",
    "fitness_at_marks",
    "fitness_function",
    "foot_bodies",
    "foot_forces",
    "learning_performance",
    "metrics",
    "model_leaves",
    "multiscale_fitness",
    "pair_fitness",
    "pair_trajectory",
]
