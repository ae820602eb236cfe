"""Bounded loss of windows, linear fits of parameters, and marginalisation of nuisance parameters.

A scan works on inner products per window of the whitened residual e (W, R) and of columns S (C, W, R), the derivatives
of the residual with respect to the parameters. The loss of a window is a bounded function of its chi^2, so that few
windows in which the linearisation fails cannot dominate. Nuisance columns (calibration tolerances) have Gaussian
priors and are fitted together with every candidate.
"""

from dataclasses import dataclass

import numpy as np

_RIDGE = 1e-9
"""Relative regularisation of the diagonal of a normal matrix."""

_REWEIGHTINGS = 4
"""Largest number of reweightings of a fit."""


def bounded_loss(x: np.ndarray, cut: np.ndarray | float) -> np.ndarray:
    """Bounded loss of windows with chi^2 x: x below the cut c, else c (2 - c / x), which is less than 2 c.

    Args:
      x: (W,) chi^2.
      cut: c, a number or (W,).
    """
    return np.where(x < cut, x, cut * (2.0 - cut / np.maximum(x, cut)))


def window_weight(x: np.ndarray, cut: np.ndarray | float) -> np.ndarray:
    """Derivative of `bounded_loss`: weight of a window in reweighted least squares, 1 below the cut, else (c / x)^2."""
    return np.where(x < cut, 1.0, (cut / np.maximum(x, cut)) ** 2)


@dataclass(frozen=True)
class Evidence:
    """Inner products per window of a residual e and columns S.

    Attributes:
      energy: (W,) e . e.
      moment: (W, C) S_c . e.
      gram: (W, C, C) S_c . S_d.
    """

    energy: np.ndarray
    moment: np.ndarray
    gram: np.ndarray

    @property
    def n(self) -> int:
        """Number of columns."""
        return self.moment.shape[1]

    def chi2(self, columns: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Chi^2 (W,) of the residual e + sum_c values_c S_c over some `columns`."""
        part = self.gram[:, columns[:, None], columns[None, :]] @ values
        return np.maximum(self.energy + 2.0 * self.moment[:, columns] @ values + part @ values, 0.0)

    def take(self, columns: np.ndarray) -> "Evidence":
        """The inner products of a subset of the columns."""
        return Evidence(self.energy, self.moment[:, columns], self.gram[:, columns[:, None], columns[None, :]])

    def windows(self, index: np.ndarray) -> "Evidence":
        """The inner products of some windows (repetitions allowed)."""
        return Evidence(self.energy[index], self.moment[index], self.gram[index])


def evidence(residual: np.ndarray, columns: np.ndarray) -> Evidence:
    """Inner products per window.

    Args:
      residual: (W, R) whitened residual.
      columns: (C, W, R) derivatives of the residual.
    """
    stacked = np.moveaxis(columns, 0, 1)  # (W, C, R)
    gram = stacked @ np.swapaxes(stacked, 1, 2)
    moment = (stacked @ residual.astype(stacked.dtype)[..., None])[..., 0]
    return Evidence((residual**2).sum(1), moment.astype(float), gram.astype(float))


@dataclass(frozen=True)
class Fit:
    """Result of a fit of columns under the bounded loss.

    Attributes:
      values: (P,) values of the free columns followed by the nuisances.
      loss: bounded loss of the windows plus the prior terms.
      chi2: (W,) of the windows.
      information: (P, P) weighted normal matrix including the priors.
    """

    values: np.ndarray
    loss: float
    chi2: np.ndarray
    information: np.ndarray


def typical_chi2(chi2: np.ndarray, freedom: int) -> float:
    """Estimate of the typical chi^2 of windows from their 0.8 quantile, at least the degrees of freedom."""
    return max(float(freedom), float(np.quantile(chi2, 0.8)) / (1.0 + 1.2 / np.sqrt(freedom)))


def fit(
    data: Evidence,
    precision: np.ndarray,
    cut: np.ndarray | float,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
) -> Fit:
    """Fit all columns under the bounded loss, by iteratively reweighted least squares.

    Args:
      data: inner products; the columns are the unknowns.
      precision: (C,) of the Gaussian priors; 0 for a free unknown.
      cut: of `bounded_loss`, a number or (W,).
      low: (C,) lower bounds or None.
      high: (C,) upper bounds or None.

    Returns:
      The iterate of smallest loss; zeros if none improves.
    """
    count = data.n
    zero = np.zeros(count)
    w = window_weight(data.energy, cut)
    best = Fit(zero, float(bounded_loss(data.energy, cut).sum()), data.energy, np.eye(count))
    if not count:
        return best
    for _ in range(_REWEIGHTINGS):
        normal = np.tensordot(w, data.gram, 1) + np.diag(precision)
        normal = regularised(normal)
        values = _box(normal, -(w @ data.moment), low, high)
        x = np.maximum(data.energy + 2.0 * data.moment @ values + (data.gram @ values) @ values, 0.0)
        loss = float(bounded_loss(x, cut).sum() + (precision * values**2).sum())
        improved = best.loss - loss
        if improved > 0:
            best = Fit(values, loss, x, normal)
        if improved < 1e-3 * max(1.0, abs(best.loss) * 1e-3):
            break
        w = window_weight(x, cut)
    return best


def regularised(normal: np.ndarray) -> np.ndarray:
    """Regularised normal matrix: the diagonal is increased relative to itself.

    Regularisation relative to the trace would depend on the units of the parameters.

    Args:
      normal: (C, C); zero diagonal elements (columns without effect) become 1.
    """
    size = np.diag(normal)
    return normal + np.diag(np.where(size > 0, _RIDGE * size, 1.0))


def _box(normal: np.ndarray, target: np.ndarray, low: np.ndarray | None, high: np.ndarray | None) -> np.ndarray:
    """Least squares with bounds, by fixing the unknowns that violate them (active set, at most 3 iterations)."""
    values = np.linalg.solve(normal, target)
    if low is None or high is None:
        return values
    fixed = np.zeros(len(values), bool)
    for _ in range(3):
        outside = ((values < low) | (values > high)) & ~fixed
        if not outside.any():
            break
        fixed |= outside
        values = np.clip(values, low, high)
        free = ~fixed
        if free.any():
            rest = target[free] - normal[np.ix_(free, fixed)] @ values[fixed]
            values[free] = np.linalg.solve(normal[np.ix_(free, free)], rest)
    return np.clip(values, low, high)


def scan_candidates(
    data: Evidence, groups: list[np.ndarray], nuisance: np.ndarray, precision: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Reduction of the weighted chi^2 by each candidate, with nuisances marginalised (Schur complement).

    Args:
      data: inner products of all columns.
      groups: columns of each candidate; a column may belong to several.
      nuisance: (N,) columns that are fitted with every candidate.
      precision: (N,) of their priors.
      weights: (W,) fixed weights of the windows.

    Returns:
      Gains (len(groups),), and fitted values without bounds, one (p,) per candidate.
    """
    gram = np.tensordot(weights, data.gram, 1)
    moment = weights @ data.moment
    if len(nuisance):
        across = gram[:, nuisance]
        block = regularised(across[nuisance] + np.diag(precision))
        solved = np.linalg.solve(block, np.column_stack([across.T, moment[nuisance]]))
        gram, moment = gram - across @ solved[:, :-1], moment - across @ solved[:, -1]
    gains, values = np.zeros(len(groups)), []
    for i, columns in enumerate(groups):
        normal = gram[np.ix_(columns, columns)]
        normal = normal + (1e-9 * np.trace(normal) + 1e-12) * np.eye(len(columns))
        theta = np.linalg.solve(normal, -moment[columns])
        values.append(theta)
        gains[i] = float(-theta @ moment[columns])
    return gains, values


def project(residual: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Residuals (..., W, R) minus their components along the `basis` (W, R, D) of each window."""
    inner = np.einsum("...wr,wrd->...wd", residual, basis, optimize=True)
    return residual - np.einsum("...wd,wrd->...wr", inner, basis, optimize=True)


def column_space(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal bases of the column spaces of Jacobians, and their pseudo-inverses.

    Args:
      jacobian: (W, R, D).

    Returns:
      Bases (W, R, D), with zero columns beyond the rank, and pseudo-inverses (W, D, R).
    """
    tall, square = np.linalg.qr(jacobian)  # cheaper than an SVD of the whole
    u, s, vt = np.linalg.svd(square, full_matrices=False)
    keep = s > 1e-9 * np.maximum(s[:, :1], 1e-300)
    basis = tall @ (u * keep[:, None, :])
    inverse = np.swapaxes(vt, 1, 2) @ (np.swapaxes(basis, 1, 2) / np.where(keep, s, 1.0)[:, :, None])
    return basis, inverse
