"""Clocks: does the delay of the response behind the commands grow along a recording?

In every stretch the delay is estimated that brings the prediction of the believed model closest to the data. A constant
delay may be physics; one that grows in proportion to the time since the start of a recording is a clock.
"""

import numpy as np

from btr_mjx.gap.data import Dataset, Noise
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.predictions import Change, Predictor

_STRETCHES = 64
_MIN_STRETCHES = 12
_SIGNIFICANT = 6.0
"""Smallest drift in units of its standard error."""

_MIN_DRIFT = 3e-4
"""Smallest drift that is reported: 0.3 ms a second is a delay of 3 ms after 10 s."""


def clock_drift(dataset: Dataset, noise: Noise) -> list[Finding]:
    """An error if the commands' clock drifts against the states'.

    Args:
      dataset: the dataset, in sound conventions.
      noise: of its sensors.
    """
    if all(np.ptp(r.ctrl, axis=0).max(initial=0) == 0 for r in dataset.recordings):
        return []
    predictor = Predictor(dataset, noise, _STRETCHES)
    if len(predictor) < _MIN_STRETCHES:
        return []
    delay, weight = _delays(dataset, noise, predictor)
    recording, since = predictor.start_times()
    found = _slope(delay, weight, recording, since)
    if found is None:
        return []
    drift, error = found
    if abs(drift) < max(_MIN_DRIFT, _SIGNIFICANT * error):
        return []
    way = "later" if drift > 0 else "earlier"
    remedy = f"multiply the times of the commands by {1 + drift:.6g}, or record both with one clock"
    message = (
        f"clocks drift: the response to the commands comes {1e3 * abs(drift):.3g} +- {1e3 * error:.2g} ms {way} for "
        f"every second of a recording; {remedy}"
    )
    evidence = {"drift_s_per_s": drift, "standard_error": error, "stretches": float(len(delay))}
    return [Finding("error", "clocks", message, remedy, evidence)]


def _delays(dataset: Dataset, noise: Noise, predictor: Predictor) -> tuple[np.ndarray, np.ndarray]:
    """Delay (W,) [s] of each stretch by least squares, and its weight (W,) (inverse variance of noise)."""
    step = 0.1 * predictor.seconds
    none = [Change.none(dataset.model)]
    (measured, late), (_, early) = (predictor.motions(none, command_shift=s)[0] for s in (step, -step))
    stronger, weaker = (predictor.motions(none, command_scale=s)[0][1] for s in (1.02, 0.98))
    middle = 0.5 * (late + early)
    with np.errstate(invalid="ignore", over="ignore"):
        size = (
            np.sqrt(np.nanmedian((measured - middle) ** 2, axis=(0, 1))) + noise.qpos
        )  # what the model does not explain
        left, by_delay, by_gain = (
            np.nan_to_num((x / size).reshape(len(measured), -1), nan=0.0, posinf=0.0, neginf=0.0)
            for x in (measured - middle, (late - early) / (2 * step), (stronger - weaker) / 0.04)
        )
    # What a change of the gain would do is taken out: a motor that fades is physics.
    gain = np.maximum(np.sum(by_gain**2, axis=1, keepdims=True), 1e-300)
    by_delay = by_delay - by_gain * np.sum(by_delay * by_gain, axis=1, keepdims=True) / gain
    weight = np.sum(by_delay**2, axis=1)
    return np.sum(by_delay * left, axis=1) / np.maximum(weight, 1e-300), weight


def _slope(
    delay: np.ndarray, weight: np.ndarray, recording: np.ndarray, since: np.ndarray
) -> tuple[float, float] | None:
    """Common slope over time of the delays of all recordings, and its standard error."""
    own = weight > 0.05 * np.median(weight)
    delay, weight, recording, since = delay[own], weight[own], recording[own], since[own]
    starts = np.unique(recording)
    if len(delay) < _MIN_STRETCHES or len(delay) < len(starts) + 8:
        return None
    columns = np.stack([since, *(np.where(recording == i, 1.0, 0.0) for i in starts)], axis=1)
    weight = np.minimum(weight, 4 * np.median(weight))
    robust = np.ones(len(delay))
    for _ in range(10):  # Huber's weights: single stretches may hold an impact
        root = np.sqrt(weight * robust)
        found = np.linalg.lstsq(root[:, None] * columns, root * delay, rcond=None)[0]
        left = np.sqrt(weight) * (delay - columns @ found)
        spread = 1.4826 * float(np.median(np.abs(left)))
        if spread == 0:
            return None
        robust = 1 / np.maximum(1.0, np.abs(left) / (1.5 * spread))
    root = np.sqrt(weight * robust)
    inverse = np.linalg.pinv((root[:, None] * columns).T @ (root[:, None] * columns))
    freedom = len(delay) - columns.shape[1]
    variance = float(np.sum(robust * left**2)) / freedom
    return float(found[0]), float(np.sqrt(variance * inverse[0, 0]))
