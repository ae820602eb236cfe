"""The missing effect from fitness alone: one number a trial, no recordings.

A `FitnessTable` holds controllers and measured fitness; `identify_fitness` ranks effects by how far Delta_fitness falls
on trials that were held out.
"""

from btr_mjx.gap.fitness_only.preflight import preflight_fitness
from btr_mjx.gap.fitness_only.screen import COARSER, Answers, simulate_candidates
from btr_mjx.gap.fitness_only.search import SCREENED, expected_steps, identify_fitness
from btr_mjx.gap.fitness_only.table import FitnessTable, load_fitness, save_fitness
from btr_mjx.gap.fitness_only.trials import TrialSimulator

__all__ = [
    "COARSER",
    "SCREENED",
    "Answers",
    "FitnessTable",
    "TrialSimulator",
    "expected_steps",
    "identify_fitness",
    "load_fitness",
    "preflight_fitness",
    "save_fitness",
    "simulate_candidates",
]
