"""Ask / tell optimisers of bounded vectors: the genetic algorithm of the paper, and CMA-ES.

`GeneticAlgorithm` keeps its state in a plain record, so that a search can be saved after every generation; `cma_es` has
a similar interface. `mutate` flips bits.
"""

from btr_mjx.optimise import cma_es
from btr_mjx.optimise.genetic_algorithm import (
    GAConfig,
    GAState,
    GeneticAlgorithm,
    ga_state_from_arrays,
    ga_state_to_arrays,
)
from btr_mjx.optimise.operators import mutate

__all__ = [
    "GAConfig",
    "GAState",
    "GeneticAlgorithm",
    "cma_es",
    "ga_state_from_arrays",
    "ga_state_to_arrays",
    "mutate",
]
