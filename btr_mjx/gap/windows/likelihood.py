"""How well a hypothesis explains windows of data, with what calibration leaves open marginalised.

All arithmetic of a scan happens on inner products per window: a residual e (W, R) in units of the noise and columns
S (C, W, R), the answers of that residual to a unit of each parameter. The loss of a window is bounded, so that a few
windows in which the linear picture fails (a touchdown, say) cannot outvote the rest, and some columns are nuisances:
tolerances with a Gaussian prior, which are fitted along and pay for it.
"""

from dataclasses import dataclass

import numpy as np

_RIDGE = 1e-9
"""Part of its own size that is added to the diagonal of a normal matrix."""


def bounded(x: np.ndarray, cut: np.ndarray | float) -> np.ndarray:
    """Loss of windows with chi^2 `x`: x up to the cut, then rising to at most twice the cut."""
    return np.where(x < cut, x, cut * (2.0 - cut / np.maximum(x, cut)))


def weight(x: np.ndarray, cut: np.ndarray | float) -> np.ndarray:
    """Derivative of `bounded`: the weight of a window in a least-squares step."""
    return np.where(x < cut, 1.0, (cut / np.maximum(x, cut)) ** 2)


@dataclass(frozen=True)
class Evidence:
    """Inner products of a residual and of columns, per window.

    Attributes:
      energy: (W,) e . e
      moment: (W, C) S_c . e
      gram: (W, C, C) S_c . S_d
    """

    energy: np.ndarray
    moment: np.ndarray
    gram: np.ndarray

    @property
    def n(self) -> int:
        """Number of columns."""
        return self.moment.shape[1]

    def chi2(self, columns: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Windows' chi^2 (W,) with `values` of some `columns` added to the residual."""
        part = self.gram[:, columns[:, None], columns[None, :]] @ values
        return np.maximum(self.energy + 2.0 * self.moment[:, columns] @ values + part @ values, 0.0)

    def take(self, columns: np.ndarray) -> "Evidence":
        """The evidence on some columns only."""
        return Evidence(self.energy, self.moment[:, columns], self.gram[:, columns[:, None], columns[None, :]])

    def windows(self, index: np.ndarray) -> "Evidence":
        """The evidence of some windows only (repetitions allowed)."""
        return Evidence(self.energy[index], self.moment[index], self.gram[index])


def evidence(residual: np.ndarray, columns: np.ndarray) -> Evidence:
    """Inner products per window.

    Args:
      residual: (W, R).
      columns: (C, W, R).
    """
    stacked = np.moveaxis(columns, 0, 1)  # (W, C, R)
    gram = stacked @ np.swapaxes(stacked, 1, 2)
    moment = (stacked @ residual.astype(stacked.dtype)[..., None])[..., 0]
    return Evidence((residual**2).sum(1), moment.astype(float), gram.astype(float))


@dataclass(frozen=True)
class Fit:
    """A least-loss fit of some columns.

    Attributes:
      values: (P,) of the free columns followed by the nuisances.
      loss: bounded loss of the windows plus the price of the nuisances.
      chi2: (W,) of the windows.
      information: (P, P) weighted normal matrix with the priors.
    """

    values: np.ndarray
    loss: float
    chi2: np.ndarray
    information: np.ndarray


def typical_chi2(chi2: np.ndarray, freedom: int) -> float:
    """A chi^2 that most windows stay below, and never less than noise gives."""
    return max(float(freedom), float(np.quantile(chi2, 0.8)) / (1.0 + 1.2 / np.sqrt(freedom)))


def fit(
    data: Evidence,
    precision: np.ndarray,
    cut: np.ndarray | float,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
    iterations: int = 4,
    weights: np.ndarray | None = None,
    centre: np.ndarray | None = None,
) -> Fit:
    """Fit all columns of some evidence under the bounded loss, by reweighted least squares.

    Args:
      data: evidence; its columns are the unknowns, in their own units.
      precision: (C,) of the Gaussian prior of every unknown around zero; 0 is free.
      cut: chi^2 above which a window counts less, a number or (W,).
      low: (C,) bounds or None.
      high: (C,) bounds or None.
      iterations: of the reweighting.
      weights: (W,) to start from; None takes those of the residual itself.
      centre: (C,) of the prior; None for zeros.

    Returns:
      The best iterate.
    """
    count = data.n
    zero = np.zeros(count)
    w = weight(data.energy, cut) if weights is None else weights
    centre = zero if centre is None else centre
    price = float((precision * centre**2).sum())
    best = Fit(zero, float(bounded(data.energy, cut).sum()) + price, data.energy, np.eye(count))
    if not count:
        return best
    for _ in range(iterations):
        normal = np.tensordot(w, data.gram, 1) + np.diag(precision)
        normal = steadied(normal)
        target = precision * centre - w @ data.moment
        values = _box(normal, target, low, high)
        x = np.maximum(data.energy + 2.0 * data.moment @ values + (data.gram @ values) @ values, 0.0)
        loss = float(bounded(x, cut).sum() + (precision * (values - centre) ** 2).sum())
        improved = best.loss - loss
        if improved > 0:
            best = Fit(values, loss, x, normal)
        if improved < 1e-3 * max(1.0, abs(best.loss) * 1e-3):
            break
        w = weight(x, cut)
    return best


def steadied(normal: np.ndarray) -> np.ndarray:
    """A normal matrix that can be solved: a little more on its diagonal, in every column's own units.

    A part of the trace instead would hold numbers that are large in SI units (a stiffness of 500 kN m/rad^3) where
    they are: their columns, per unit, are the smallest.

    Args:
      normal: (C, C), with zeros where a column does nothing.
    """
    size = np.diag(normal)
    return normal + np.diag(np.where(size > 0, _RIDGE * size, 1.0))


def _box(normal: np.ndarray, target: np.ndarray, low: np.ndarray | None, high: np.ndarray | None) -> np.ndarray:
    """Least squares in a box, by fixing the unknowns that leave it (enough for one or a few of them)."""
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
    """Gain of every candidate over the nuisances alone, in one quadratic form with fixed window weights.

    Args:
      data: evidence of all columns.
      groups: per candidate its columns; a column may be in several.
      nuisance: (N,) columns that are fitted along with every candidate.
      precision: (N,) of their priors.
      weights: (W,) of the windows.

    Returns:
      Gains (len(groups),) and a list of values, one (p,) per candidate, unbounded.
    """
    gram = np.tensordot(weights, data.gram, 1)
    moment = weights @ data.moment
    if len(nuisance):
        across = gram[:, nuisance]
        block = across[nuisance] + np.diag(precision) + 1e-12 * np.eye(len(nuisance))
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
    """What is left of residuals (..., W, R) after the directions of each window's `basis` (W, R, D) are taken out."""
    inner = np.einsum("...wr,wrd->...wd", residual, basis, optimize=True)
    return residual - np.einsum("...wd,wrd->...wr", inner, basis, optimize=True)


def spanned(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the columns of jacobians (W, R, D) span, and their pseudo-inverses.

    Returns:
      Orthonormal bases (W, R, D), in which columns without effect become zero, and the inverses (W, D, R).
    """
    tall, square = np.linalg.qr(jacobian)  # half the time of a decomposition of the whole
    u, s, vt = np.linalg.svd(square, full_matrices=False)
    keep = s > 1e-9 * np.maximum(s[:, :1], 1e-300)
    basis = tall @ (u * keep[:, None, :])
    inverse = np.swapaxes(vt, 1, 2) @ (np.swapaxes(basis, 1, 2) / np.where(keep, s, 1.0)[:, :, None])
    return basis, inverse
