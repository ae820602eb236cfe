"""Statistics of distance curves over one parameter: how well they lead to the truth, and effects of averaging.

All functions use saved fitness or distances and simulate nothing.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.evaluation import metrics, multiscale_fitness


def curve_numbers(
    grid: np.ndarray, curves: np.ndarray, truth: float, prefix: str = "", keep: np.ndarray | None = None
) -> dict[str, float]:
    """Statistics of one curve, or their means over several curves.

    Args:
      grid: (G,) values of the parameter.
      curves: (..., G) a distance there.
      truth: the parameter's value in reality.
      prefix: of the names.
      keep: (G,) bool, points that are used, such as the range of influence; None for all.

    Returns:
      rho: Spearman's, between distance and error |grid - truth|; rho_sides: mean of rho over both sides of the truth,
      which is not lower for a valley with unequal sides; monotonicity: fraction of neighbours in the right order;
      roughness: total variation / range; roughness_sides: mean of roughness over both sides, 1 if both are monotonic
      (a whole valley has 1 .. 2, depending on how equal its sides are); linearity: Pearson's r between distance and
      error, mean of both sides; off: |argmin - truth|.
    """
    use = np.ones(len(grid), bool) if keep is None else keep
    x, y = grid[use], np.asarray(curves, float)[..., use]
    error = np.abs(x - truth)
    finite = np.isfinite(y)
    least = np.where(finite, y, np.inf).argmin(axis=-1)
    # A side with fewer than three points has no rho: then the other side is used alone.
    sides = [side for side in (x <= truth, x >= truth) if side.sum() > 2]
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore")  # means of curves that are all NaN
        nothing = [np.full(y.shape[:-1], np.nan)]
        by_side = np.stack([metrics.spearman(y[..., side], error[side]) for side in sides] or nothing)
        rough = np.stack([metrics.roughness(y[..., side]) for side in sides] or nothing)
        straight = np.stack([_pearson(y[..., side], error[side]) for side in sides] or nothing)
        numbers = {
            "rho": metrics.spearman(y, error),
            "rho_sides": np.nanmean(by_side, axis=0),
            "monotonicity": metrics.monotonicity(y, error),
            "roughness": metrics.roughness(y),
            "roughness_sides": np.nanmean(rough, axis=0),
            "linearity": np.nanmean(straight, axis=0),
            "off": np.abs(x[least] - truth),
        }
        means = {prefix + name: float(np.nanmean(value)) for name, value in numbers.items()}
    return means


def _pearson(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Pearson's r along the last axis of curves y (..., G) with x (G,), over their finite points."""
    finite = np.isfinite(y)
    count = finite.sum(-1, keepdims=True)
    centred = np.where(finite, y - np.nanmean(y, axis=-1, keepdims=True), 0.0)
    base = np.where(finite, x - (x * finite).sum(-1, keepdims=True) / count, 0.0)
    return (centred * base).sum(-1) / np.sqrt((centred**2).sum(-1) * (base**2).sum(-1))


def multiscale_curve(f_s: np.ndarray, f_r: np.ndarray) -> np.ndarray:
    """`distances.multiscale_fitness` of saved fitness.

    Args:
      f_s: (..., m, K + 1) at the marks and at T_e.
      f_r: (m, K + 1) in reality.

    Returns:
      (...).
    """
    return multiscale_fitness(f_s[..., :-1], f_r[..., :-1])


def plateau_sensitivity(grid: np.ndarray, fitness: np.ndarray, low: float, high: float, apart: float = 0.1) -> float:
    """Sensitivity of behaviours to a parameter within [low, high], relative to elsewhere.

    The sensitivity at a point is the mean over behaviours of |f(x + apart) - f(x)|: Delta_fitness between two
    simulations that differ by `apart`.

    Args:
      grid: (G,) ascending values of the parameter.
      fitness: (G, m).
      low: of the plateau.
      high: of the plateau.
      apart: distance of the simulations compared.

    Returns:
      Mean within (both simulations in [low, high]) over mean elsewhere; 1 means no plateau.
    """
    step = sensitivity_along(grid, fitness, apart)
    ends = np.minimum(grid + apart, grid[-1])
    inside = (grid >= low - 1e-9) & (ends <= high + 1e-9)
    outside = ((ends <= low + 1e-9) | (grid >= high - 1e-9)) & np.isfinite(step)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.nanmean(step[inside]) / np.nanmean(step[outside]))


def sensitivity_along(grid: np.ndarray, fitness: np.ndarray, apart: float = 0.1) -> np.ndarray:
    """Mean over behaviours of |f(x + apart) - f(x)| at every grid point (G,), f interpolated; NaN past the end."""
    there = grid + apart
    ahead = np.stack([np.interp(there, grid, column, right=np.nan) for column in fitness.T], axis=1)
    return np.abs(ahead - fitness).mean(axis=1)


def influence(grid: np.ndarray, fitness: Sequence[np.ndarray], truth: float, share: float = 0.25) -> np.ndarray:
    """The parameter's range of influence, which Hypotheses 3 and 4 are about.

    Args:
      grid: (G,) ascending values of the parameter.
      fitness: of every seed (G, m).
      truth: the parameter's value in reality.
      share: of the strongest influence.

    Returns:
      (G,) bool, the interval around the truth in which the sensitivity (`sensitivity_along`, mean over seeds) is at
      least `share` of its maximum.
    """
    rows = np.array([sensitivity_along(grid, each) for each in fitness])
    finite = np.isfinite(rows)
    mean = np.where(finite, rows, 0.0).sum(axis=0) / np.where(finite.any(axis=0), finite.sum(axis=0), np.nan)
    known = np.where(np.isfinite(mean), mean, mean[np.flatnonzero(np.isfinite(mean))[-1]])
    strong = known >= share * known.max()
    strong[np.abs(grid - truth).argmin()] = True
    weak = np.flatnonzero(~strong)
    left = grid[weak[grid[weak] < truth]].max(initial=-np.inf)
    right = grid[weak[grid[weak] > truth]].min(initial=np.inf)
    return (grid > left) & (grid < right)


@dataclass(frozen=True)
class Draws:
    """Random choices of behaviours.

    Attributes:
      count: number of choices.
      seed: of the choices, and of noise where there is any.
    """

    count: int = 64
    seed: int = 0


def subset_numbers(
    grid: np.ndarray,
    delta: np.ndarray,
    truth: float,
    sizes: Sequence[int],
    keep: np.ndarray | None = None,
    draws: Draws = Draws(),
) -> dict[int, dict[str, float]]:
    """Statistics of Delta_fitness of m behaviours, averaged over random choices of them.

    Args:
      grid: (G,).
      delta: (G, M) delta_k.
      truth: the parameter's value in reality.
      sizes: values of m, at most M.
      keep: as for `curve_numbers`.
      draws: the random choices.

    Returns:
      By m.
    """
    rng = np.random.default_rng([draws.seed, 31])
    choices = [rng.permutation(delta.shape[1]) for _ in range(draws.count)]
    numbers = {}
    for m in sizes:
        curves = np.stack([delta[:, choice[:m]].mean(axis=1) for choice in choices])
        numbers[m] = curve_numbers(grid, curves if m < delta.shape[1] else curves[:1], truth, keep=keep)
    return numbers


def noise_numbers(
    grid: np.ndarray,
    f_s: np.ndarray,
    f_r: np.ndarray,
    truth: float,
    sizes: Sequence[int],
    noise: float,
    keep: np.ndarray | None = None,
    draws: Draws = Draws(),
) -> dict[int, dict[str, float]]:
    """As `subset_numbers`, with a relative error of standard deviation `noise` of every measured f_r.

    Args:
      grid: (G,).
      f_s: (G, M) fitness in the simulations.
      f_r: (M,) fitness in reality, exact.
      truth: the parameter's value in reality.
      sizes: values of m, at most M.
      noise: 0.05 = 5 %.
      keep: as for `curve_numbers`.
      draws: the random choices and noises.

    Returns:
      By m.
    """
    rng = np.random.default_rng([draws.seed, 32])
    choices = [rng.permutation(len(f_r)) for _ in range(draws.count)]
    measured = f_r * (1 + noise * rng.standard_normal((draws.count, len(f_r))))
    numbers = {}
    for m in sizes:
        pairs = zip(choices, measured, strict=True)
        curves = np.stack([np.abs(f_s[:, c[:m]] - row[c[:m]]).mean(axis=1) for c, row in pairs])
        numbers[m] = curve_numbers(grid, curves, truth, keep=keep)
    return numbers


# ---- over seeds ----


def interval(values: ArrayLike, statistic: Any = np.mean) -> dict[str, float]:
    """Estimate and 95 % bootstrap interval over seeds; seeds without a number are left out."""
    samples = np.asarray(values, float)
    samples = samples[np.isfinite(samples)]
    if not len(samples):
        return {"estimate": np.nan, "low": np.nan, "high": np.nan, "seeds": 0}
    found = metrics.bootstrap_interval(samples, statistic)
    return {
        "estimate": float(found.estimate),
        "low": float(found.low),
        "high": float(found.high),
        "seeds": len(samples),
    }


def intervals(rows: Sequence[Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Mean with interval, and median, of every statistic over seeds."""
    names = rows[0].keys()
    return {
        name: {
            **interval([row[name] for row in rows]),
            "median": float(np.nanmedian([row[name] for row in rows])),
        }
        for name in names
    }
