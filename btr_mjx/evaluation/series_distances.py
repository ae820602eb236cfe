"""Distances between sensor series: the rolling mean metric (Bongard and Lipson, 2004) and the Euclidean metric.

The paper compares them with Delta_fitness in Fig. 5. Both are metrics in the mathematical sense on the first h steps
(the "header") of scaled series: zero only between equal series, symmetric, and within the triangle inequality.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from btr_mjx.errors import InputError

Floats = NDArray[np.float64]

DEFAULT_WINDOW = 42
"""Default length of the rolling mean [steps]: 1.25 % of 3400 steps, the shortest header of the paper (21 ms).

Long enough to smooth contact impulses, short beside the period of a gait.
"""


def sensor_scale(reference: ArrayLike, groups: Sequence[Any] | None = None) -> Floats:
    """Scale of every sensor, so that metres, radians and newtons can be averaged.

    Args:
      reference: (..., N_b, n_sensors) series of the reference (reality): N_b steps, any number of behaviours.
      groups: n_sensors labels; sensors with the same label (such as all contact forces) share the root mean square of
        their standard deviations. None scales each sensor by its own.

    Returns:
      (n_sensors,) standard deviation over steps and behaviours, in the sensor's own unit. A constant sensor
      without a group has the scale inf, so that the metrics ignore it.

    Raises:
      InputError: fewer than two axes, NaN or infinite entries, or a wrong number of labels.
    """
    array = np.asarray(reference, dtype=np.float64)
    if array.ndim < 2 or 0 in array.shape:
        raise InputError(f"reference: got shape {array.shape}, expected (..., N_b, n_sensors) with data in it")
    if not np.isfinite(array).all():
        raise InputError("reference: got NaN or infinite entries, expected finite series; leave out what diverged")
    flat = array.reshape(-1, array.shape[-1])
    spread = flat.std(axis=0)
    # Rounding gives a constant series a tiny spread, by which it must not be divided.
    spread[np.ptp(flat, axis=0) == 0] = 0.0
    if groups is not None:
        if len(groups) != len(spread):
            raise InputError(f"groups: got {len(groups)} labels, expected {len(spread)}, one per sensor")
        members = np.array([[a == b for b in groups] for a in groups], dtype=np.float64)
        spread = np.sqrt(members @ spread**2 / members.sum(axis=1))
    return np.where(spread > 0, spread, np.inf)


def _scaled_difference(x_r: ArrayLike, x_s: ArrayLike, header: ArrayLike | None, scale: ArrayLike):
    """Scaled x_r - x_s over the longest header, the headers as an array, and whether a single header was given."""
    real, simulated = np.asarray(x_r, dtype=np.float64), np.asarray(x_s, dtype=np.float64)
    if real.ndim < 2 or simulated.ndim < 2 or real.shape[-2:] != simulated.shape[-2:]:
        raise InputError(
            f"sensor series: got shapes {real.shape} and {simulated.shape}, expected (..., N_b, n_sensors) with equal "
            "N_b and n_sensors"
        )
    n_steps, n_sensors = real.shape[-2:]
    headers = np.asarray(n_steps if header is None else header)
    valid = headers.size and np.issubdtype(headers.dtype, np.integer) and headers.ndim <= 1
    if not valid or headers.min() < 1 or headers.max() > n_steps:
        raise InputError(f"header: got {header!r}, expected whole numbers of steps within 1 .. {n_steps}")
    divisor = np.asarray(scale, dtype=np.float64)
    if divisor.shape not in ((), (n_sensors,)) or not (divisor > 0).all():
        raise InputError(
            f"scale: got {scale!r}, expected one positive number, or {n_sensors} of them; sensor_scale makes them"
        )
    longest = int(headers.max())
    try:
        difference = (real[..., :longest, :] - simulated[..., :longest, :]) / divisor
    except ValueError:
        raise InputError(
            f"sensor series: got shapes {real.shape} and {simulated.shape}, expected leading axes that broadcast"
        ) from None
    return difference, np.atleast_1d(headers), headers.ndim == 0


def _mean_over_headers(per_step: Floats, headers: NDArray[np.int64], single: bool) -> Floats:
    means = np.stack([per_step[..., :h].mean(axis=-1) for h in headers.tolist()], axis=-1)
    return means[..., 0] if single else means


def rolling_mean_metric(
    x_r: ArrayLike,
    x_s: ArrayLike,
    header: int | Sequence[int],
    window: int = DEFAULT_WINDOW,
    scale: ArrayLike = 1.0,
) -> Floats:
    """Rolling mean metric (Bongard and Lipson, 2004), as in the paper's Fig. 5.

    Mean over the first h steps and all sensors of |rolling mean of x_r - rolling mean of x_s|. The window is causal:
    the mean at step j is over steps max(0, j - window + 1) .. j, so that the metric does not depend on samples after
    its header. With `window` 1 it is the mean absolute difference.

    Args:
      x_r: (..., N_b, n_sensors) series of reality; leading axes broadcast against those of `x_s`.
      x_s: (..., N_b, n_sensors) series of the simulation.
      header: h, number of steps compared, 1 .. N_b; several headers cost hardly more than the longest.
      window: steps in the rolling mean, at least 1.
      scale: (n_sensors,) or one number, divisor of each sensor, see `sensor_scale`.

    Returns:
      (...) distances, or (..., H) for H headers; NaN where a series is NaN within the header.

    Raises:
      InputError: shapes that do not match, headers outside 1 .. N_b, a window below 1, scales that are not positive.
    """
    if not isinstance(window, (int, np.integer)) or window < 1:
        raise InputError(f"window: got {window!r}, expected a whole number of steps, 1 or more")
    with np.errstate(invalid="ignore", over="ignore"):  # diverged series become NaN
        difference, headers, single = _scaled_difference(x_r, x_s, header, scale)
        # The rolling mean is linear, so the difference of means is the mean of differences.
        total = np.cumsum(difference, axis=-2)
        total[..., window:, :] -= total[..., :-window, :].copy()
        counts = np.minimum(np.arange(1, total.shape[-2] + 1), window)
        per_step = np.abs(total).mean(axis=-1) / counts
        return _mean_over_headers(per_step, headers, single)


def euclidean_metric(
    x_r: ArrayLike, x_s: ArrayLike, header: int | Sequence[int] | None = None, scale: ArrayLike = 1.0
) -> Floats:
    """Root mean square difference of scaled series over h steps and all sensors.

    This is the Euclidean distance divided by the square root of the number of entries, so that it does not grow with
    the length of the header.

    Args:
      x_r: (..., N_b, n_sensors) series of reality; leading axes broadcast against those of `x_s`.
      x_s: (..., N_b, n_sensors) series of the simulation.
      header: h, number of steps compared; None compares all, as the dashed line of Fig. 5.
      scale: (n_sensors,) or one number, see `sensor_scale`.

    Returns:
      (...) distances, or (..., H) for H headers; NaN where a series is NaN within the header.

    Raises:
      InputError: as `rolling_mean_metric`.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        difference, headers, single = _scaled_difference(x_r, x_s, header, scale)
        per_step = np.einsum("...ij,...ij->...i", difference, difference) / difference.shape[-1]
        return np.sqrt(_mean_over_headers(per_step, headers, single))
