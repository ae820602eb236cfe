"""Least squares of numbers and calibration on whitened innovations, and the evidence for a hypothesis.

    -2 ln p = |u_0 + U theta + V eta|^2 + eta^T P eta

u_0 is the residual, U and V the columns of free numbers and of calibration, P the inverse covariance of calibration:
that of independent tolerances, or of what other recordings of the same robot leave open. A number that calibration
explains costs the square of its size in tolerances, which is what naming it would save.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_PATIENCE = 3
"""Exchanges of all unknowns at once without progress, from which on one at a time is exchanged."""

_EXCHANGES = 200
"""Exchanges of unknowns with bounds, at most."""

_RIDGE = 1e-10
"""Relative ridge of a normal matrix."""


@dataclass(frozen=True, eq=False)
class CalibrationPrior:
    """Numbers of calibration, with Gaussian priors around 0 and bounds.

    Attributes:
      design: (C, n) columns of each; several columns where one number is that of several places.
      tolerance: (n,) 1 sigma of each, whatever the others are.
      reach: (n,) largest size of each: what is further off is missing, not badly calibrated. Whatever makes all forces
        smaller leaves less of them, so that without a bound gains would vanish where friction is missing.
      at: (n,) values at which the columns were taken.
      inverse: (n, n) inverse covariance of numbers that are known together; None where they are independent.
    """

    design: np.ndarray
    tolerance: np.ndarray
    reach: np.ndarray
    at: np.ndarray
    inverse: np.ndarray | None = None

    @property
    def precision(self) -> np.ndarray:
        """(n, n) inverse covariance."""
        return np.diag(1.0 / self.tolerance**2) if self.inverse is None else self.inverse


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """A fit of free numbers beside calibration.

    Attributes:
      values: (p,) changes of the free numbers.
      calibration: (n,) values of calibration.
      loss: -2 ln p, without what all hypotheses share.
    """

    values: np.ndarray
    calibration: np.ndarray
    loss: float


def least_squares(
    gram: np.ndarray,
    free: np.ndarray,
    prior: CalibrationPrior,
    low: Sequence[float] | np.ndarray | None = None,
    high: Sequence[float] | np.ndarray | None = None,
) -> LeastSquares:
    """Fit free numbers and calibration.

    Args:
      gram: (1 + C, 1 + C) inner products of residual and columns.
      free: (C, p) columns of each free number; several columns for a number that several places share.
      prior: calibration beside them.
      low: (p,) lower bounds of the changes; None for none.
      high: (p,) upper bounds; None for none.

    Returns:
      The fit.
    """
    p = free.shape[1]
    design = np.concatenate([free, prior.design], 1)
    inner, across = gram[1:, 1:], gram[1:, 0]
    normal, target = design.T @ inner @ design, -design.T @ across
    normal[p:, p:] += prior.precision
    target[p:] -= prior.precision @ prior.at
    bounds = (
        np.r_[np.full(p, -np.inf) if low is None else low, -prior.reach - prior.at],
        np.r_[np.full(p, np.inf) if high is None else high, prior.reach - prior.at],
    )
    values = _bounded(normal, target, bounds)
    effect, total = design @ values, prior.at + values[p:]
    chi2 = float(gram[0, 0] + 2 * effect @ across + effect @ inner @ effect)
    return LeastSquares(values[:p], total, chi2 + penalty(total, prior))


def penalty(calibration: np.ndarray, prior: CalibrationPrior) -> float:
    """-2 ln of the prior of calibration (n,), without a constant."""
    return float(calibration @ prior.precision @ calibration)


def _bounded(normal: np.ndarray, target: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Minimum of a convex quadratic within bounds, by block principal pivoting (Kostreva 1978; Judice and Pires 1994).

    Unknowns beyond their bounds are fixed there, and those whose slope leads inwards are free again.
    """
    low, high = bounds
    ridged, fixed = _ridged(normal), np.zeros(len(target), int)  # -1 at the lower bound, 1 at the upper one
    fewest, patience, values = len(target) + 1, _PATIENCE, np.zeros(len(target))
    for _ in range(_EXCHANGES):
        free = fixed == 0
        values = np.where(fixed < 0, low, np.where(fixed > 0, high, 0.0))
        rest = target[free] - ridged[np.ix_(free, ~free)] @ values[~free]
        values[free] = np.linalg.solve(ridged[np.ix_(free, free)], rest)
        inwards = fixed * (ridged @ values - target) > 0
        beyond = np.where(free, (values > high).astype(int) - (values < low), 0)
        wrong = np.flatnonzero(inwards | (beyond != 0))
        if not len(wrong):
            break
        if len(wrong) < fewest:
            fewest, patience = len(wrong), _PATIENCE
        else:
            patience -= 1
        chosen = wrong if patience > 0 else wrong[-1:]
        fixed[chosen] = beyond[chosen]
    return np.clip(values, low, high)


def _ridged(normal: np.ndarray) -> np.ndarray:
    size = np.diag(normal)
    return normal + np.diag(np.where(size > 0, _RIDGE * size, 1.0))
