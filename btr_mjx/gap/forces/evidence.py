"""Least squares of numbers and calibration on whitened innovations, and the evidence for a hypothesis.

    -2 ln p = |u_0 + U theta + V eta|^2 + sum over kinds of calibration (nu + n) ln(1 + sum (eta / tolerance)^2 / nu)

u_0 is the residual, U and V the columns of free numbers and of calibration. Every kind of calibration (masses, gains,
zeros, ...) has a common scale that is unknown: its numbers are drawn from a multivariate Student distribution with `NU`
degrees of freedom around the stated tolerance. A number that is as large as its kind usually is costs little, one that
stands out costs what naming it saves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

NU = 2.0
"""Degrees of freedom of the scale of a kind of calibration: tolerances are stated to within a factor of a few."""

MOST = 8.0
"""Largest number of calibration, in tolerances: what is further off is missing, not badly calibrated. Whatever makes
all forces smaller leaves less of them, so that without a bound gains would vanish where friction is missing."""

_FIXED = 6
"""Times that unknowns beyond their bounds are fixed there."""

_REWEIGHTED = 4
"""Iterations of the scales of calibration."""

_RIDGE = 1e-10
"""Relative ridge of a normal matrix."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Numbers of calibration.

    Attributes:
      design: (C, n) columns of each; several where one number is that of several places.
      tolerance: (n,) 1 sigma of each.
      kind: (n,) integers: numbers of one kind share a scale.
      at: (n,) values at which the columns were taken; the prior is centred at 0.
      nu: degrees of freedom of the scale of a kind; infinite where tolerances are what they are said to be.
    """

    design: np.ndarray
    tolerance: np.ndarray
    kind: np.ndarray
    at: np.ndarray
    nu: float = NU


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit of free numbers beside calibration.

    Attributes:
      values: (p,) changes of the free numbers.
      calibration: (n,) values of calibration.
      chi2: of the innovations.
      penalty: of calibration.
      covariance: (p, p) of the free numbers.
      effect: (C,) coefficients of all columns.
    """

    values: np.ndarray
    calibration: np.ndarray
    chi2: float
    penalty: float
    covariance: np.ndarray
    effect: np.ndarray

    @property
    def loss(self) -> float:
        """-2 ln p, without what all hypotheses share."""
        return self.chi2 + self.penalty


def least_squares(
    gram: np.ndarray,
    free: np.ndarray,
    calibration: Calibration,
    low: Sequence[float] | np.ndarray | None = None,
    high: Sequence[float] | np.ndarray | None = None,
    scales: np.ndarray | None = None,
) -> Fit:
    """Fit free numbers and calibration.

    Args:
      gram: (1 + C, 1 + C) inner products of residual and columns.
      free: (C, p) columns of each free number; several columns for a number that several places share.
      calibration: beside them.
      low: (p,) lower bounds of the changes; None for none.
      high: (p,) upper bounds; None for none.
      scales: (n,) squared scales of calibration to start with; None for 1.

    Returns:
      The fit.
    """
    p, n = free.shape[1], len(calibration.tolerance)
    design = np.concatenate([free, calibration.design], 1)
    inner, across = gram[1:, 1:], gram[1:, 0]
    normal, target = design.T @ inner @ design, -design.T @ across
    scale = np.ones(n) if scales is None else scales
    reach = MOST * calibration.tolerance
    bounds = (
        np.r_[np.full(p, -np.inf) if low is None else low, -reach - calibration.at],
        np.r_[np.full(p, np.inf) if high is None else high, reach - calibration.at],
    )
    for _ in range(_REWEIGHTED if n else 1):
        weight = 1.0 / (scale * calibration.tolerance**2)
        full = normal.copy()
        full[p + np.arange(n), p + np.arange(n)] += weight
        aim = target.copy()
        aim[p:] -= weight * calibration.at
        values = _bounded(full, aim, bounds)
        total = calibration.at + values[p:]
        scale = _scales(total / calibration.tolerance, calibration)
    effect = design @ values
    chi2 = float(gram[0, 0] + 2 * effect @ across + effect @ inner @ effect)
    covariance = np.linalg.inv(_ridged(full))[:p, :p]
    return Fit(values[:p], total, chi2, _penalty(total / calibration.tolerance, calibration), covariance, effect)


def _bounded(normal: np.ndarray, target: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Minimum of a quadratic within bounds: those beyond them are fixed, one after another."""
    low, high = bounds
    fixed, values = np.zeros(len(target), bool), np.zeros(len(target))
    for _ in range(_FIXED):
        free = ~fixed
        rest = target[free] - normal[np.ix_(free, fixed)] @ values[fixed]
        values[free] = np.linalg.solve(_ridged(normal[np.ix_(free, free)]), rest)
        outside = ((values < low) | (values > high)) & free
        if not outside.any():
            break
        fixed |= outside
        values = np.clip(values, low, high)
    return values


def _ridged(normal: np.ndarray) -> np.ndarray:
    size = np.diag(normal)
    return normal + np.diag(np.where(size > 0, _RIDGE * size, 1.0))


def _scales(relative: np.ndarray, calibration: Calibration) -> np.ndarray:
    """(n,) squared scale of each number's kind, its mode beside the numbers."""
    out, kind, nu = np.ones(len(relative)), calibration.kind, calibration.nu
    for k in np.unique(kind) if np.isfinite(nu) else ():
        own = kind == k
        out[own] = (nu + (relative[own] ** 2).sum()) / (nu + own.sum())
    return out


def _penalty(relative: np.ndarray, calibration: Calibration) -> float:
    """-2 ln of the Student prior of all kinds."""
    total, kind, nu = 0.0, calibration.kind, calibration.nu
    if not np.isfinite(nu):
        return float((relative**2).sum())
    for k in np.unique(kind):
        own = kind == k
        total += float((nu + own.sum()) * np.log1p((relative[own] ** 2).sum() / nu))
    return total
