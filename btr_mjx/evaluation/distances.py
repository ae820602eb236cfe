"""Multiscale distance of a simulation from reality: fitness compared at several times of a trial.

`delta_fitness_of` (in `fitness`) compares the fitness of whole trials. Motion with contacts is chaotic: over long
trials small parameter errors grow until the final fitness hardly depends on their size. The paper concludes that "an
account of multi time scale behavioral comparisons is required". `multiscale_fitness` compares the same fitness function
at several early times of the trial (marks), each in units of its own spread over the behaviours.
"""

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.evaluation.fitness import FitnessFunction, Outcome

MARKS = tuple(float(t) for t in np.linspace(0.00625, 0.05, 8))
"""Default marks [s]: eight within the first 0.05 s, where the motion is not yet chaotic."""

CLIP = 3.0
"""Default limit of a scaled difference [standard deviations], which bounds the influence of chaotic behaviours."""


def fitness_at_marks(outcome: Outcome, fitness: FitnessFunction) -> np.ndarray:
    """Fitness (..., K), in its own unit, of trials as if they had ended at each of K sample times."""
    values = []
    for k in range(1, len(outcome.times) + 1):
        early = Outcome(
            outcome.times[:k],
            outcome.start,
            outcome.position[..., :k, :],
            outcome.energy[..., :k],
            None if outcome.qpos is None else outcome.qpos[..., :k, :],
            None if outcome.qvel is None else outcome.qvel[..., :k, :],
            None if outcome.act is None else outcome.act[..., :k, :],
        )
        values.append(fitness(early))
    return np.stack(values, axis=-1)


def multiscale_fitness(f_s: ArrayLike, f_r: ArrayLike, clip: float = CLIP) -> np.ndarray:
    """Mean over behaviours and marks of min(|f_s - f_r| / spread, clip).

    The spread of a mark is the standard deviation of f_r over the behaviours, so that all marks have equal weight
    although fitness differences grow during a trial.

    Args:
      f_s: (..., m, K) fitness of m behaviours at K marks in simulations.
      f_r: (m, K) the same in reality, m >= 2; rows that are not finite (failed trials) are left out.
      clip: limit of a scaled difference.

    Returns:
      (...); 0 where all agree, NaN where a behaviour diverged in a simulation.

    Raises:
      InputError: shapes that do not match, fewer than two usable behaviours, clip not positive.
    """
    simulated, real = np.asarray(f_s, np.float64), np.asarray(f_r, np.float64)
    if real.ndim != 2 or simulated.shape[-2:] != real.shape:
        raise InputError(
            f"f_s of shape {simulated.shape} and f_r of shape {real.shape}: expected (..., m, K) and (m, K), one "
            "fitness per behaviour and mark"
        )
    if not clip > 0:
        raise InputError(f"clip: got {clip}, expected a positive number")
    usable = np.isfinite(real).all(axis=1)
    if usable.sum() < 2:
        raise InputError(f"f_r: {usable.sum()} finite behaviours, expected at least 2 to know the spread at each mark")
    simulated, real = simulated[..., usable, :], real[usable]
    spread = real.std(axis=0)
    # Where all behaviours are equal in reality the spread is zero: any difference counts as `clip`.
    spread = np.where(spread > 0, spread, np.finfo(np.float64).tiny)
    with np.errstate(over="ignore"):
        scaled = np.minimum(np.abs(simulated - real) / spread, clip)
    return scaled.mean(axis=(-2, -1))
