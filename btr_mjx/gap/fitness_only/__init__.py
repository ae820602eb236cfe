"""The missing effect from fitness alone: one number a trial, no recordings.

A `FitnessTable` holds controllers and measured fitness. `identify_fitness` ranks effects by the reduction of
Delta_fitness = mean of abs(f_s - f_r), on the trials to fit and on held-out trials.
"""

from btr_mjx.gap.fitness_only.fitness_search import SCREENING_TRIALS, expected_steps, identify_fitness
from btr_mjx.gap.fitness_only.fitness_table import FitnessTable, load_fitness, preflight_fitness, save_fitness
from btr_mjx.gap.fitness_only.screen import COARSE_FACTORS, CandidateResponses, simulate_candidates
from btr_mjx.gap.fitness_only.trials import TrialSimulator

__all__ = [
    "COARSE_FACTORS",
    "SCREENING_TRIALS",
    "CandidateResponses",
    "FitnessTable",
    "TrialSimulator",
    "expected_steps",
    "identify_fitness",
    "load_fitness",
    "preflight_fitness",
    "save_fitness",
    "simulate_candidates",
]
