"""Optimisation of a function of vectors by a complete run of the genetic algorithm.

found = minimize(lambda x: ((x - 1) ** 2).sum(axis=1), box, seed=0, generations=40)
found.values, found.fitness
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from btr_mjx.errors import InputError
from btr_mjx.optimise.genetic_algorithm import GAConfig, GAState, GeneticAlgorithm, Seed
from btr_mjx.robots import Box

Objective = Callable[[NDArray[np.float64]], ArrayLike]
"""(M, n) vectors of a box -> (M,) fitness, NaN where the evaluation failed."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """Result of `optimise`, for G generations of M vectors with n parameters.

    Attributes:
      values: (n,) the best vector evaluated, NaN where every evaluation failed.
      fitness: its fitness, NaN likewise.
      best_values: (G, n) the best so far after each generation.
      best_fitness: (G,) its fitness.
      mean_fitness: (G,) mean over the finite members of each generation, NaN where there are none.
      failed: (G,) number of members without a finite fitness.
      state: the state after the last generation, from which the run can be continued.
    """

    values: NDArray[np.float64]
    fitness: float
    best_values: NDArray[np.float64]
    best_fitness: NDArray[np.float64]
    mean_fitness: NDArray[np.float64]
    failed: NDArray[np.int64]
    state: GAState


def optimise(
    fn: Objective, box: Box, config: GAConfig, *, seed: Seed, generations: int, start: ArrayLike | None = None
) -> Optimum:
    """Run the genetic algorithm; the configuration determines whether it maximises or minimises.

    Args:
      fn: maps (M, n) vectors to (M,) fitness, NaN where the evaluation failed.
      box: the space searched.
      config: settings.
      seed: an integer or a generator.
      generations: G >= 1; `fn` is called once a generation.
      start: (n,) vector from which the first generation is made by bit flips; None starts at random.

    Returns:
      The best vector, the course of the run and its last state.

    Raises:
      InputError: fewer than one generation, a start outside the box, fitness of the wrong shape.
    """
    if generations < 1:
        raise InputError(f"generations: got {generations}, expected at least 1")
    ga = GeneticAlgorithm(box, config)
    state = ga.init(seed, None if start is None else box.encode(start))
    values, best, mean, failed = [], [], [], []
    for _ in range(generations):
        genomes, state = ga.ask(state)
        fitness = np.asarray(fn(box.decode(genomes)), dtype=np.float64)
        state = ga.tell(state, genomes, fitness)
        finite = fitness[np.isfinite(fitness)]
        values.append(np.full(box.n, np.nan) if state.best_genome is None else box.decode(state.best_genome))
        best.append(state.best_fitness)
        mean.append(finite.mean() if finite.size else np.nan)
        failed.append(config.population - finite.size)
    return Optimum(
        values[-1], best[-1], np.array(values), np.array(best), np.array(mean), np.array(failed, np.int64), state
    )


def minimize(
    fn: Objective,
    box: Box,
    config: GAConfig | None = None,
    *,
    seed: Seed,
    generations: int,
    start: ArrayLike | None = None,
) -> Optimum:
    """Minimise a function; arguments and result as of `optimise`.

    Raises:
      InputError: a configuration that maximises; and as `optimise`.
    """
    config = GAConfig(maximise=False) if config is None else config
    if config.maximise:
        raise InputError("minimize: got a configuration with maximise=True, expected maximise=False; or call optimise")
    return optimise(fn, box, config, seed=seed, generations=generations, start=start)
