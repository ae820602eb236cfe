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
    least, most = (f"{length:.3g}" for length in np.percentile(1e3 * steps, [1, 99]))
    apart = f"one every {least} ms" if least == most else f"{least} to {most} ms apart (the middle 98 %)"
    findings.append(Finding("note", "sampling", f"{rates} samples per second, {apart}"))
    for recording in dataset.recordings:
        own = np.diff(recording.time)
        count, k = int((own > 3 * usual[recording.name]).sum()), int(np.argmax(own))
        if count:
            longest = f"{recording.time[k]:.6g} to {recording.time[k + 1]:.6g} s"
            message = f"{recording.name}: {count} gaps of more than three intervals, the longest from {longest}"
            findings.append(Finding("warning", "gaps", message))
    sparse = [(f * usual[r.name], f) for r in dataset.recordings if (f := _command_frequency(r)) > 0]
    share, tempo = max(sparse, default=(0.0, 0.0))
    if share > 0.1:
        period = f"{tempo:.3g} Hz, {1 / share:.1f} samples a period"
        message = f"commands turn over at {period}; delays and velocities are hard to see below ten"
        findings.append(Finding("warning", "sampling", message))
    step = dataset.model.opt.timestep
    if step > 1.001 * fast:  # time stamps are rounded
        message = f"the model's time step of {step:g} s is longer than a sampling interval"
        findings.append(Finding("warning", "sampling", message))
    return findings


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
    message = f"{recording.name}: time: samples are {usual:.6g} s apart, which looks like {what}; {remedy}"
    return Finding("error", "units", message, remedy, {"interval": usual})


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
        own = [_shift(r.time, r.ctrl[:, joint.actuator], r.qpos[:, q]) for r in dataset.recordings]
        if found := [s for s in own if s is not None]:
            shifts.append((joint.name, float(np.median(found))))
    if not shifts:
        return []
    values = np.array([shift for _, shift in shifts])
    apart = f" ({1e3 * values.min():.3g} to {1e3 * values.max():.3g} ms)" if len(values) > 1 else ""
    text = f"positions follow commands by {1e3 * np.median(values):.3g} ms{apart}, the servo's own dynamics included"
    findings = [Finding("note", "clocks", text)]
    early = [name for name, shift in shifts if shift < -1.5 * usual]
    if 2 * len(early) >= len(shifts):  # clocks are common to all joints; one alone is pushed by something
        message = f"positions come before their commands at {listed(early)}; do both share one clock?"
        findings.append(Finding("warning", "clocks", message))
    return findings


def _shift(time: np.ndarray, command: np.ndarray, response: np.ndarray) -> float | None:
    """Lag [s] within +-0.25 s of the largest cross-correlation of the slopes; None if the correlation is below 0.7."""
    step = float(np.median(np.diff(time)))
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
