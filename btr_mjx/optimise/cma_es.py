"""CMA-ES (Hansen and Ostermeier, 2001; package `cmaes`) with nothing to remember but what was told.

The strategy after any generation follows from its start and from all members told since, so that a search can be saved
as those members and go on later to the bit: `restored` tells them again (12 parameters, 100 generations of 50: a third
of a second).

    strategy = restored(start, members, scores, population=32)
    asked = ask(strategy, seed)
    tell(strategy, asked, f(asked))

Vectors lie in the unit cube; see `spaces.Box` for what they stand for.
"""

from typing import Any

import cmaes
import numpy as np

from btr_mjx.errors import InputError

SIGMA = 0.125
"""Default first step size, as a share of each parameter's range."""

CONVERGED = 5e-5
"""A population whose spread in every parameter is below this share of its range has nothing left to find."""


def restored(
    start: np.ndarray, members: np.ndarray, scores: np.ndarray, *, population: int, sigma: float = SIGMA
) -> cmaes.CMA:
    """The strategy as it is after some generations.

    Args:
      start: (n,) first mean, in the unit cube.
      members: (g, L, n) all members told so far, g may be 0.
      scores: (g, L) what they were told, to be minimised; not finite where the evaluation failed.
      population: L.
      sigma: first step size.

    Raises:
      InputError: a start outside the unit cube, a step size that is not positive, fewer than 4 members.
    """
    start = np.array(start, np.float64)
    if not ((start >= 0) & (start <= 1)).all():
        raise InputError(f"start: got {start}, expected a point of the unit cube")
    if not sigma > 0 or population < 4:
        raise InputError(f"sigma {sigma} and population {population}: expected more than 0 and at least 4")
    bounds = np.tile([0.0, 1.0], (len(start), 1))
    strategy = cmaes.CMA(mean=start, sigma=sigma, bounds=bounds, population_size=population, seed=0)
    for generation, values in zip(members, scores, strict=True):
        tell(strategy, generation, values)
    return strategy


def ask(strategy: cmaes.CMA, seed: Any) -> np.ndarray:
    """The next generation (L, n), drawn from a seed of its own; any number, or list of numbers, that numpy takes."""
    strategy.reseed_rng(int(np.random.SeedSequence(seed).generate_state(1)[0]))
    return np.array([strategy.ask() for _ in range(strategy.population_size)])


def tell(strategy: cmaes.CMA, members: np.ndarray, scores: np.ndarray) -> None:
    """Take in a generation; failed members count as twice as bad as the worst that did not fail.

    Args:
      strategy: moves on by one generation.
      members: (L, n), what was asked or what took its place.
      scores: (L,) not negative, to be minimised.
    """
    finite = scores[np.isfinite(scores)]
    worst = 2 * finite.max() if len(finite) else 1.0
    told = np.where(np.isfinite(scores), scores, worst)
    strategy.tell([(x, float(value)) for x, value in zip(np.array(members), told, strict=True)])


def converged(members: np.ndarray) -> bool:
    """Whether a generation (L, n) has shrunk to a point."""
    return bool(members.std(axis=0).max() < CONVERGED)
