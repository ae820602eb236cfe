"""Searches for simulations by a genetic algorithm, CMA-ES and Adam, with records of all members.

A search minimises a distance over unknown parameters and keeps every member of every generation for the figures. It is
a pure function of its seed and of the distances.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import optax

from btr_mjx.optimise import GAConfig, GeneticAlgorithm
from btr_mjx.optimise import cma_es as cma
from btr_mjx.robots import Box

Distance = Callable[[np.ndarray], np.ndarray]
"""(L, n) values of the unknown parameters -> (L,) distances, NaN where a simulation failed."""


@dataclass(frozen=True, eq=False)
class Search:
    """All members of a search.

    Attributes:
      parameters: (g, L, n).
      values: (g, L) their distances.
      simulated: (g,) number of members that were simulated: repeated genomes keep their distance.
    """

    parameters: np.ndarray
    values: np.ndarray
    simulated: np.ndarray

    @property
    def best(self) -> np.ndarray:
        """(g, n) parameters of the least distance found up to each generation."""
        count = self.values.shape[1]
        flat = np.where(np.isfinite(self.values), self.values, np.inf).ravel()
        least = np.array([flat[: (g + 1) * count].argmin() for g in range(len(self.values))])
        return self.parameters.reshape(-1, self.parameters.shape[-1])[least]

    def error(self, truth: np.ndarray) -> np.ndarray:
        """(g,) mean absolute error of `best`, in the parameters' unit."""
        return np.abs(self.best - truth).mean(axis=-1)


def away_from(truth: np.ndarray, box: Box, distance: float, seed: int) -> np.ndarray:
    """A start (n,) whose every parameter lies `distance` from the truth, on a random side but inside the box."""
    sign = np.random.default_rng([seed, 41]).choice([-1.0, 1.0], len(truth))
    there = truth + sign * distance
    inside = (there >= box.low) & (there <= box.high)
    return np.clip(np.where(inside, there, truth - sign * distance), box.low, box.high)


def genetic(
    distance: Distance,
    box: Box,
    start: np.ndarray,
    population: int,
    generations: int,
    p_m: tuple[float, float],
    seed: int,
    tournament: int = 5,
) -> Search:
    """Step 3 of Back-to-Reality: a random population with s_0 as one of its members and a decreasing mutation rate.

    A random population and a high initial mutation rate avoid that the search ends in a local minimum of Delta_fitness
    near s_0.

    Args:
      distance: what is minimised.
      box: the unknown parameters, with the bits of their genomes.
      start: (n,) s_0.
      population: L.
      generations: number of generations.
      p_m: probability per bit of flipping a bit, in the first and in the last generation; geometric in between.
      seed: of everything random.
      tournament: members per tournament; fewer preserve diversity for longer.
    """
    algorithms = [
        GeneticAlgorithm(box, GAConfig(maximise=False, population=population, p_m=float(p), tournament=tournament))
        for p in np.geomspace(*p_m, generations)
    ]
    state = algorithms[0].init(np.random.default_rng([seed, 42]))
    known: dict[bytes, float] = {}
    parameters, values, simulated = [], [], []
    for generation, algorithm in enumerate(algorithms):
        genomes, state = algorithm.ask(state)
        if generation == 0:
            genomes = np.concatenate([box.encode(start)[None], genomes[1:]])
        members, keys = box.decode(genomes), [genome.tobytes() for genome in genomes]
        new = {key: i for i, key in enumerate(keys) if key not in known}
        if new:
            known |= zip(new, distance(members[list(new.values())]).tolist(), strict=True)
        told = np.array([known[key] for key in keys])
        state = algorithm.tell(state, genomes, told)
        parameters.append(members)
        values.append(told)
        simulated.append(len(new))
    return Search(np.array(parameters), np.array(values), np.array(simulated))


def cma_es(
    distance: Distance,
    box: Box,
    start: np.ndarray,
    population: int,
    generations: int,
    seed: int,
    sigma: float = cma.SIGMA,
) -> Search:
    """CMA-ES from s_0, in the box scaled to the unit cube.

    Args:
      distance: what is minimised.
      box: the unknown parameters.
      start: (n,) s_0.
      population: L.
      generations: maximum number; the search stops earlier once it has converged.
      seed: of everything random.
      sigma: initial step size, as a fraction of each parameter's range.
    """
    nothing = np.zeros((0, population, box.n))
    strategy = cma.restored((start - box.low) / box.span, nothing, nothing[..., 0], population=population, sigma=sigma)
    parameters, values = [], []
    for generation in range(generations):
        asked = cma.ask(strategy, [seed, generation])
        members = np.clip(box.low + box.span * asked, box.low, box.high)
        told = distance(members)
        cma.tell(strategy, asked, told)
        parameters.append(members)
        values.append(told)
        if cma.converged(asked):
            break
    return Search(np.array(parameters), np.array(values), np.full(len(values), population))


def adam(
    distance: Distance, box: Box, start: np.ndarray, generations: int, rate: float = 0.03, apart: float = 0.004
) -> Search:
    """Adam (Kingma and Ba, 2015; package `optax`) from s_0, in the box scaled to the unit cube.

    Gradients are central differences of a smooth distance: the members of a generation are the present point and its
    2 n neighbours. A parameter whose neighbours failed is not changed in that generation.

    Args:
      distance: what is minimised.
      box: the unknown parameters.
      start: (n,) s_0.
      generations: number of steps; the step size decays to zero as a cosine.
      rate: initial step size, as a fraction of each parameter's range.
      apart: distance of the neighbours, as a fraction of each parameter's range.
    """
    strategy = optax.adam(optax.cosine_decay_schedule(rate, generations))
    point = (start - box.low) / box.span
    state = strategy.init(point)
    neighbours = np.concatenate([np.zeros((1, box.n)), apart * np.eye(box.n), -apart * np.eye(box.n)])
    parameters, values = [], []
    for _ in range(generations):
        asked = np.clip(point + neighbours, 0.0, 1.0)
        members = box.low + box.span * asked
        told = distance(members)
        between = (asked[1 : box.n + 1] - asked[box.n + 1 :]).sum(axis=1)
        gradient = np.nan_to_num((told[1 : box.n + 1] - told[box.n + 1 :]) / between)
        update, state = strategy.update(gradient, state)
        point = np.clip(point + np.asarray(update), 0.0, 1.0)
        parameters.append(members)
        values.append(told)
    return Search(np.array(parameters), np.array(values), np.full(len(values), len(neighbours)))
