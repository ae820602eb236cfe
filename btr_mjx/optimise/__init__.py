"""Ask / tell optimisers of bounded vectors: the genetic algorithm of the paper, and CMA-ES.

`GeneticAlgorithm` keeps its state in a plain record, so that a search can be saved after every generation; `cma_es` has
the same shape. `mutate` is the bit flip that experiments use on their own.
"""

from btr_mjx.optimise.genetic_algorithm import GAConfig, GAState, GeneticAlgorithm
from btr_mjx.optimise.operators import mutate

__all__ = [
    "GAConfig",
    "GAState",
    "GeneticAlgorithm",
    "mutate",
]
