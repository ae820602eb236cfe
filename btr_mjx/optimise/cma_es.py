"""CMA-ES (Hansen and Ostermeier, 2001; package `cmaes`), resumable from the history of its generations.

The state of the strategy is a function of its start and of all generations told so far. A search is saved as those
generations and resumed bit for bit: `restored` tells them again, which takes little time compared with evaluations.

    strategy = restored(start, members, scores, population=32)
    asked = ask(strategy, seed)
    tell(strategy, asked, f(asked))

Vectors lie in the unit cube, to which parameters are scaled by the bounds of their `Box`.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from btr_mjx.errors import InputError

if TYPE_CHECKING:
    import cmaes

SIGMA = 0.125
"""Default initial step size, as a fraction of each parameter's range."""

CONVERGED = 5e-5
"""Standard deviation of a generation in every parameter, as a fraction of its range, below which it has converged."""


def restored(
    start: np.ndarray, members: np.ndarray, scores: np.ndarray, *, population: int, sigma: float = SIGMA
) -> "cmaes.CMA":
    """The state of the strategy, ready for `ask`, after it was told members (g, L, n) of the unit cube; g may be 0.

    Scores (g, L) are to be minimised, not finite where the evaluation failed. The start (n,) is the initial mean, sigma
    the initial step size.

    Raises:
      InputError: a start outside the unit cube, a step size that is not positive, fewer than 4 members.
    """
    import cmaes  # loads scipy.stats and more, which takes a second

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


def ask(strategy: "cmaes.CMA", seed: Any) -> np.ndarray:
    """The next generation (L, n), drawn with its own seed: an integer or a list of integers, as of SeedSequence."""
    strategy.reseed_rng(int(np.random.SeedSequence(seed).generate_state(1)[0]))
    return np.array([strategy.ask() for _ in range(strategy.population_size)])


def tell(strategy: "cmaes.CMA", members: np.ndarray, scores: np.ndarray) -> None:
    """Update the strategy with a generation; failed members get twice the worst finite score.

    Args:
      strategy: updated in place.
      members: (L, n) the members asked, or members that replace them.
      scores: (L,) not negative, to be minimised; not finite where the evaluation failed.
    """
    finite = scores[np.isfinite(scores)]
    worst = 2 * finite.max() if len(finite) else 1.0
    told = np.where(np.isfinite(scores), scores, worst)
    strategy.tell([(x, float(value)) for x, value in zip(np.array(members), told, strict=True)])


def converged(members: np.ndarray) -> bool:
    """Whether the spread of a generation (L, n) is below `CONVERGED` in every parameter."""
    return bool(members.std(axis=0).max() < CONVERGED)
