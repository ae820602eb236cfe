"""Checks of timing: sampling rate, gaps, delay of positions behind commands."""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.data import Dataset, Recording, listed
from btr_mjx.gap.preflight.excitation import JointTrack
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.models import part_names

_SLOWEST = 0.5
"""Sampling interval [s] from which on time is taken to be in a smaller unit: no robot's motion is sampled so slowly."""

_FASTEST = 1e-6
"""Sampling interval [s] below which it is taken to be in a larger unit."""

_UNITS = (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))
_USUAL = 5e-3
"""Typical sampling interval [s]; the unit of time stamps is that in which theirs is nearest to it, by ratio."""


def sampling(dataset: Dataset) -> list[Finding]:
    """Check unit of time, sampling rate, gaps, and samples per period of the commands, in each recording."""
    findings = [found for r in dataset.recordings for found in [_time_unit(r)] if found is not None]
    if findings:
        return findings[:1]
    usual = {r.name: float(np.median(np.diff(r.time))) for r in dataset.recordings}
    steps = np.concatenate([np.diff(r.time) for r in dataset.recordings])
    slow, fast = max(usual.values()), min(usual.values())
    rates = f"{1 / slow:.1f}" if slow < 1.2 * fast else f"{1 / slow:.1f} to {1 / fast:.1f}"
    findings.append(
        Finding(
            "note",
            "sampling",
            f"{rates} samples per second, {_intervals(*np.percentile(1e3 * steps, [1, 99]))}",
        )
    )
    for recording in dataset.recordings:
        gaps = np.flatnonzero(np.diff(recording.time) > 3 * usual[recording.name])
        if len(gaps):
            k = int(gaps[np.argmax(np.diff(recording.time)[gaps])])
            findings.append(
                Finding(
                    "warning",
                    "gaps",
                    f"{recording.name}: {len(gaps)} gaps of more than three intervals, the longest from "
                    f"{recording.time[k]:.6g} to {recording.time[k + 1]:.6g} s",
                )
            )
    sparse = [(f * usual[r.name], f) for r in dataset.recordings if (f := _command_frequency(r)) > 0]
    share, tempo = max(sparse, default=(0.0, 0.0))
    if share > 0.1:
        findings.append(
            Finding(
                "warning",
                "sampling",
                f"commands turn over at {tempo:.3g} Hz, {1 / share:.1f} samples a period; delays and "
                "velocities are hard to see below ten",
            )
        )
    if dataset.model.opt.timestep > 1.001 * fast:  # time stamps are rounded
        findings.append(
            Finding(
                "warning",
                "sampling",
                f"the model's time step of {dataset.model.opt.timestep:g} s is longer than a sampling interval",
            )
        )
    return findings


def _intervals(least: float, most: float) -> str:
    """The middle 98 % of intervals [ms] in words."""
    low, high = f"{least:.3g}", f"{most:.3g}"
    return f"one every {low} ms" if low == high else f"{low} to {high} ms apart (the middle 98 %)"


def _time_unit(recording: Recording) -> Finding | None:
    """An error where times of a recording are not in seconds."""
    usual = float(np.median(np.diff(recording.time)))
    if _FASTEST <= usual < _SLOWEST:
        return None
    what, factor = "another unit", 1.0
    if usual >= _SLOWEST:
        what, factor = min(_UNITS, key=lambda unit: abs(np.log(usual / unit[1] / _USUAL)))
        if recording.time[0] / factor > 1e8:
            what += " since 1970"
    remedy = f"the column time is in seconds: divide by {factor:.0e}" if factor > 1 else "the column time is in seconds"
    return Finding(
        "error",
        "units",
        f"{recording.name}: time: samples are {usual:.6g} s apart, which looks like {what}; {remedy}",
        remedy,
        {"interval": usual},
    )


def _command_frequency(recording: Recording) -> float:
    """Median over commands of half the rate of crossings of the mean [Hz]; 0 for constant commands."""
    rates = []
    for column in recording.ctrl.T:
        if np.ptp(column) > 0:
            wave = np.sign(column - np.mean(column))
            rates.append(0.5 * np.count_nonzero(np.diff(wave)) / (recording.time[-1] - recording.time[0]))
    return float(np.median(rates)) if rates else 0.0


def response_delays(dataset: Dataset, joints: Sequence[JointTrack]) -> list[Finding]:
    """Delay of the positions of servo joints behind their commands, servo dynamics included."""
    model, shifts = dataset.model, []
    usual = max(float(np.median(np.diff(r.time))) for r in dataset.recordings)
    for joint in joints:
        if not joint.servo or joint.actuator is None or np.ptp(joint.ctrl) == 0:
            continue
        q = int(model.jnt_qposadr[part_names(model, "joint").index(joint.name)])
        own = [
            _shift(r.time, r.ctrl[:, joint.actuator], r.qpos[:, q], float(np.median(np.diff(r.time))))
            for r in dataset.recordings
        ]
        found = [s for s in own if s is not None]
        if found:
            shifts.append((joint.name, float(np.median(found))))
    if not shifts:
        return []
    values = np.array([shift for _, shift in shifts])
    findings = [
        Finding(
            "note",
            "clocks",
            f"positions follow commands by {1e3 * np.median(values):.3g} ms ({1e3 * values.min():.3g} to "
            f"{1e3 * values.max():.3g} ms), the servo's own dynamics included",
        )
    ]
    early = [name for name, shift in shifts if shift < -1.5 * usual]
    if 2 * len(early) >= len(shifts):  # clocks are common to all joints; one alone is pushed by something
        findings.append(
            Finding(
                "warning",
                "clocks",
                f"positions come before their commands at {listed(early)}; do both share one clock?",
            )
        )
    return findings


def _shift(time: np.ndarray, command: np.ndarray, response: np.ndarray, step: float) -> float | None:
    """Lag [s] within +-0.25 s of the largest cross-correlation of the slopes; None if the correlation is below 0.7."""
    even = np.arange(time[0], time[-1], step)
    if len(even) < 40 or np.ptp(command) == 0 or np.ptp(response) == 0:
        return None
    a, b = (np.interp(even, time, x) for x in (command, response))
    # A periodic command fits again after a period, so that less than half of one is searched.
    period = 2 * len(even) / max(int(np.count_nonzero(np.diff(a > np.mean(a)))), 1)
    a, b = (np.gradient(x) - np.mean(np.gradient(x)) for x in (a, b))
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    if size == 0:
        return None
    reach = max(1, min(int(0.25 / step), len(even) // 4, int(0.45 * period)))
    padded = 2 * len(even)  # so that the transform's circle does not close
    products = np.fft.irfft(np.fft.rfft(b, padded) * np.conj(np.fft.rfft(a, padded)), padded)
    scores = np.concatenate([products[padded - reach :], products[: reach + 1]]) / size
    best = int(np.argmax(scores))
    return (best - reach) * step if scores[best] > 0.7 else None
