"""Shape of a distance curve over one parameter (Hypotheses 3 and 4 of the paper): does it lead a search to the truth?

Spearman's rho between the distance and the true error, over the whole range or on each side of the truth; the share of
neighbouring grid points in the right order; roughness. All functions work on the last axis and keep the leading axes.
A NaN on a curve (a diverged simulation) is left out. A statistic that is not defined is NaN.
"""

import numpy as np
import scipy
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.evaluation.series_distances import Floats


def _curves(delta: ArrayLike, other: ArrayLike, what: str) -> tuple[Floats, Floats]:
    y, x = np.asarray(delta, dtype=np.float64), np.asarray(other, dtype=np.float64)
    if y.ndim == 0 or x.ndim == 0 or y.shape[-1] != x.shape[-1]:
        raise InputError(
            f"got delta of shape {y.shape} and {what} of shape {x.shape}, expected (..., G) both, one per grid point"
        )
    try:
        y, x = np.broadcast_arrays(y, x)
    except ValueError:
        raise InputError(
            f"got delta of shape {y.shape} and {what} of shape {x.shape}, expected leading axes that broadcast"
        ) from None
    return y, x


def spearman(delta: ArrayLike, error: ArrayLike) -> Floats:
    """Spearman's rank correlation between a distance and the true error, ties at their mean rank.

    Args:
      delta: (..., G) a distance on G grid points, such as Delta_fitness.
      error: (..., G) |s_i - s_ri| there; broadcasts against `delta`.

    Returns:
      (...) rho within [-1, 1]; NaN where fewer than two points are finite or either side is constant.

    Raises:
      InputError: shapes that do not match.
    """
    y, x = _curves(delta, error, "error")
    known = np.isfinite(y) & np.isfinite(x)
    n = known.sum(axis=-1, keepdims=True)
    deviations = []
    for values in (y, x):
        # Points that are left out rank last; the ranks of the n others have the mean (n + 1) / 2, with ties or without.
        rank = scipy.stats.rankdata(np.where(known, values, np.inf), axis=-1)
        deviations.append(np.where(known, rank - (n + 1) / 2, 0.0))
    a, b = deviations
    with np.errstate(invalid="ignore"):
        rho = (a * b).sum(axis=-1) / np.sqrt((a * a).sum(axis=-1) * (b * b).sum(axis=-1))
    return np.clip(rho, -1.0, 1.0)


def side_spearman(delta: ArrayLike, values: ArrayLike, truth: float) -> Floats:
    """Spearman's rho between a distance and |values - truth| on each side of the truth.

    A valley that is steeper on one side guides a search well although its rho over both sides is below 1.

    Args:
      delta: (..., G) a distance on G grid points.
      values: (G,) the parameter there, in its own unit, in any order.
      truth: the true value; a grid point there belongs to both sides.

    Returns:
      (..., 2) rho below and above the truth; NaN for a side with fewer than three finite points, since the rho of two
      points is always 1 or -1.

    Raises:
      InputError: shapes that do not match.
    """
    grid = np.asarray(values, dtype=np.float64)
    if grid.ndim != 1:
        raise InputError(f"values: got shape {grid.shape}, expected (G,): one grid for all curves")
    y, _ = _curves(delta, grid, "values")
    error = np.abs(grid - truth)
    sides = []
    for side in (grid <= truth, grid >= truth):
        enough = np.isfinite(y[..., side]).sum(axis=-1) >= 3
        sides.append(np.where(enough, spearman(y[..., side], error[side]), np.nan))
    return np.stack(sides, axis=-1)


def monotonicity(delta: ArrayLike, error: ArrayLike) -> Floats:
    """Share of neighbouring grid pairs that the distance orders as the true error does.

    A pair of equal errors (on either side of the truth) has no order and is not counted; a pair of equal distances and
    unequal errors, as on a plateau, counts as not ordered.

    Args:
      delta: (..., G) a distance on G grid points, in the order of the grid.
      error: (..., G) |s_i - s_ri| there; broadcasts against `delta`.

    Returns:
      (...) share within [0, 1]; NaN where no pair can be compared.

    Raises:
      InputError: shapes that do not match.
    """
    y, x = _curves(delta, error, "error")
    dy, dx = np.diff(y, axis=-1), np.diff(x, axis=-1)
    # Errors of mirror points of a symmetric grid differ by rounding only.
    ordered = np.abs(dx) > 1e-9 * np.abs(x).max(axis=-1, keepdims=True, initial=0.0)
    comparable = ordered & np.isfinite(dy) & np.isfinite(dx)
    agree = comparable & (np.sign(dy) == np.sign(dx))
    with np.errstate(invalid="ignore"):
        return agree.sum(axis=-1) / comparable.sum(axis=-1)


def roughness(delta: ArrayLike) -> Floats:
    """Total variation of a curve divided by its range.

    1 for a monotonic curve, at most 2 for a single valley; it grows with every further local extremum.

    Args:
      delta: (..., G) a distance on G grid points, in the order of the grid.

    Returns:
      (...) at least 1; NaN for a flat curve or one with fewer than two finite points.

    Raises:
      InputError: a single number.
    """
    y = np.asarray(delta, dtype=np.float64)
    if y.ndim == 0:
        raise InputError("delta: got a single number, expected (..., G)")
    known = np.isfinite(y)
    # Repeating the last finite point adds no variation: missing points are bridged.
    index = np.maximum.accumulate(np.where(known, np.arange(y.shape[-1]), -1), axis=-1)
    joined = np.where(index >= 0, np.take_along_axis(y, np.maximum(index, 0), axis=-1), np.nan)
    variation = np.nansum(np.abs(np.diff(joined, axis=-1)), axis=-1)
    spread = np.where(known, y, -np.inf).max(axis=-1, initial=-np.inf) - np.where(known, y, np.inf).min(
        axis=-1, initial=np.inf
    )
    defined = np.isfinite(spread) & (spread > 0)
    return np.where(defined, variation / np.where(defined, spread, 1.0), np.nan)[()]
