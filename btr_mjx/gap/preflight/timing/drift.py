"""Clocks: does the delay of the response behind the commands grow along a recording?

In every stretch the delay of each coordinate is estimated that brings the prediction of the believed model closest to
the data. A constant delay may be physics, and so may one that follows the motion: friction and damping delay slow and
small motion by another time than fast and large motion. A delay that grows in proportion to the time since the start of
a recording, whatever the motion, is a clock.
"""

import numpy as np

from btr_mjx.gap.data import Dataset, Noise
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.predictions import Change, Predictor, Reading
from btr_mjx.models import difference

_STRETCHES = 64
_MIN_STRETCHES = 12
_SIGNIFICANT = 6.0
"""Smallest drift in units of its standard error."""

_MIN_DRIFT = 3e-4
"""Smallest drift that is reported: 0.3 ms a second is a delay of 3 ms after 10 s."""

_AROUND = 8.0
"""The motion around a stretch is that of so many lengths of it on either side: a period or two."""

_OWN_TIME = 0.3
"""Smallest share of the variance of time that the motion does not explain: in a sweep, a delay that follows time is the
same as one that follows the motion."""


def clock_drift(dataset: Dataset, noise: Noise) -> list[Finding]:
    """An error if the commands' clock drifts against the states'; of data in sound conventions."""
    if all(np.ptp(r.ctrl, axis=0).max(initial=0) == 0 for r in dataset.recordings):
        return []
    predictor = Predictor(dataset, noise, _STRETCHES)
    if len(predictor) < _MIN_STRETCHES:
        return []
    delay, weight = _delays(dataset, noise, predictor)
    recording, since = predictor.start_times()
    found = _slope(delay, weight, recording, since, _motion(dataset, recording, since, predictor.seconds))
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
    """Delays (W, nv) [s] of each stretch by least squares, and their weights (W, nv) (inverse variances of noise)."""
    step = 0.1 * predictor.seconds
    none = [Change.none(dataset.model)]
    (measured, late), (_, early) = (predictor.motions(none, Reading(shift=s))[0] for s in (step, -step))
    stronger, weaker = (predictor.motions(none, Reading(scale=s))[0][1] for s in (1.02, 0.98))
    middle = 0.5 * (late + early)
    with np.errstate(invalid="ignore", over="ignore"):
        # What the model does not explain.
        size = np.sqrt(np.nanmedian((measured - middle) ** 2, axis=(0, 1))) + noise.qpos
        left, by_delay, by_gain = (
            np.nan_to_num(x / size, nan=0.0, posinf=0.0, neginf=0.0)
            for x in (measured - middle, (late - early) / (2 * step), (stronger - weaker) / 0.04)
        )
    # What a change of the gain would do is taken out: a motor that fades is physics.
    gain = np.maximum(np.sum(by_gain**2, axis=(1, 2), keepdims=True), 1e-300)
    by_delay = by_delay - by_gain * np.sum(by_delay * by_gain, axis=(1, 2), keepdims=True) / gain
    weight = np.sum(by_delay**2, axis=1)
    return np.sum(by_delay * left, axis=1) / np.maximum(weight, 1e-300), weight


def _motion(dataset: Dataset, recording: np.ndarray, since: np.ndarray, seconds: float) -> np.ndarray:
    """Logarithms of frequency [1/s] and size of the motion around each stretch, (W, nv, 2)."""
    out = np.zeros((len(since), dataset.model.nv, 2))
    for w, (i, start) in enumerate(zip(recording, since, strict=True)):
        one = dataset.recordings[i]
        times = one.time[0] + start + _AROUND * seconds * np.array([-1, 1])
        rows = slice(*np.searchsorted(one.time, times))
        moves = difference(one.model, one.qpos[rows][:1], one.qpos[rows])
        size = np.maximum(np.std(moves, axis=0), 1e-12)
        speed = np.maximum(np.sqrt(np.mean(one.qvel[rows] ** 2, axis=0)), 1e-12)
        out[w] = np.log(np.stack([speed / size, size], axis=1))
    return out


def _slope(
    delay: np.ndarray, weight: np.ndarray, recording: np.ndarray, since: np.ndarray, motion: np.ndarray
) -> tuple[float, float] | None:
    """Common slope over time of the delays of all recordings, and its standard error.

    Each coordinate may have a delay of its own that follows its motion.
    """
    stretch, dof = np.nonzero(weight > 0.05 * np.median(weight.max(axis=1)))
    starts, dofs = np.unique(recording), np.unique(dof)
    if len(np.unique(stretch)) < max(_MIN_STRETCHES, len(starts) + 8):
        return None
    delay, weight, motion = (values[stretch, dof] for values in (delay, weight, motion))
    recording = recording[stretch]
    of_dof = [np.where(dof == v, column, 0.0) for v in dofs for column in (np.ones(len(dof)), *motion.T)]
    constant = np.stack([np.where(recording == i, 1.0, 0.0) for i in starts], axis=1)
    others = np.concatenate([constant, np.stack(of_dof, axis=1)], axis=1)
    weight = np.minimum(weight, 4 * np.median(weight))
    robust = np.ones(len(delay))
    for _ in range(10):  # Huber's weights: single stretches may hold an impact
        root = np.sqrt(weight * robust)
        time, late = _without(others, root, since[stretch]), _without(others, root, delay)
        power = float(time @ time)
        if power <= _OWN_TIME * float(np.sum(_without(constant, root, since[stretch]) ** 2)):
            return None
        drift = float(time @ late) / power
        left = late - time * drift
        spread = 1.4826 * float(np.median(np.abs(left / np.sqrt(robust))))
        if spread == 0:
            return None
        robust = 1 / np.maximum(1.0, np.abs(left / np.sqrt(robust)) / (1.5 * spread))
    per_stretch = np.bincount(stretch, time * left)  # coordinates of a stretch err together
    freedom = len(delay) - np.linalg.matrix_rank(others) - 1
    return drift, float(np.sqrt(np.sum(per_stretch**2) * len(delay) / freedom) / power)


def _without(columns: np.ndarray, root: np.ndarray, values: np.ndarray) -> np.ndarray:
    """What least squares with weights root^2 leave of values, times root."""
    columns, values = root[:, None] * columns, root * values
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=1e-9)[0])
