"""Bootstrap confidence intervals over independent samples, such as one number per seed."""

import functools
import inspect
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from btr_mjx.errors import InputError
from btr_mjx.evaluation.series_distances import Floats


@dataclass(frozen=True, eq=False)
class Interval:
    """A statistic and its bootstrap confidence interval.

    Attributes:
      estimate: (...) the statistic of the samples themselves.
      low: (...) lower end; NaN where there is one sample only.
      high: (...) upper end, likewise.
      percentile: (...) whether the interval is the percentile interval, where BCa is undefined.
    """

    estimate: Floats
    low: Floats
    high: Floats
    percentile: NDArray[np.bool_]


def bootstrap_interval(
    samples: ArrayLike,
    statistic: Callable[..., Any] = np.mean,
    level: float = 0.95,
    seed: int = 0,
    n_resamples: int = 9999,
) -> Interval:
    """Bootstrap confidence interval over independent samples, such as one number per seed.

    Bias-corrected and accelerated (BCa, Efron 1987; `scipy.stats.bootstrap`). Where BCa is undefined, as for equal
    samples or a median whose jackknife does not vary, the percentile interval of the same resamples is used.
    Intervals from few samples are too narrow: nominal 95 % intervals of the mean of n normal samples cover the true
    mean with a probability of 74 % for n = 3, 84 % for n = 5 and 93 % for n = 15.

    Args:
      samples: (..., n) finite numbers, independent along the last axis.
      statistic: maps (..., n) to (...) given `axis=-1`, or (n,) to a number if it has no argument `axis`.
      level: confidence level within (0, 1).
      seed: of the resampling.
      n_resamples: number of resamples.

    Returns:
      Estimate and interval; for one sample the interval is NaN.

    Raises:
      InputError: no samples, NaN or infinite samples, a level outside (0, 1).
    """
    array = np.asarray(samples, dtype=np.float64)
    if array.ndim == 0 or 0 in array.shape:
        raise InputError(f"samples: got shape {array.shape}, expected (..., n) with at least one sample")
    if not np.isfinite(array).all():
        raise InputError("samples: got NaN or infinite ones, expected finite numbers; leave them out and report it")
    if not 0 < level < 1:
        raise InputError(f"level: got {level!r}, expected a confidence level within (0, 1), such as 0.95")
    if "axis" not in inspect.signature(statistic).parameters:
        statistic = functools.partial(_along_axis, statistic)
    estimate = np.asarray(statistic(array, axis=-1), dtype=np.float64)
    if array.shape[-1] == 1:
        unknown = np.full(estimate.shape, np.nan)
        return Interval(estimate, unknown, unknown, np.zeros(estimate.shape, dtype=bool))

    def interval(method: str, **more: Any) -> Any:
        keywords: dict[str, Any] = {"axis": -1, "confidence_level": level, "method": method, "vectorized": True}
        return scipy.stats.bootstrap((array,), statistic, **keywords, **more)

    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # scipy warns of degenerate samples, which are handled below
        plain = interval("percentile", n_resamples=n_resamples, rng=np.random.default_rng(seed))
        bca = interval("BCa", n_resamples=0, bootstrap_result=plain)
    ends, fallback = bca.confidence_interval, plain.confidence_interval
    undefined = ~(np.isfinite(ends.low) & np.isfinite(ends.high))
    low, high = np.where(undefined, fallback.low, ends.low), np.where(undefined, fallback.high, ends.high)
    return Interval(estimate, low, high, undefined)


def _along_axis(statistic: Callable[..., Any], samples: Floats, axis: int) -> Floats:
    return np.apply_along_axis(statistic, axis, samples)
