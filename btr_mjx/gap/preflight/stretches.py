"""Short stretches of recordings for checks: a bounded number, spread over all recordings, where something moves."""

from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.models import difference

_SHORTEST, _LONGEST = 0.02, 0.5
"""Bounds of the length of a stretch [s]."""

_TURN = 1.0
"""Largest rms rotation of a free or ball joint in a stretch [rad]: beyond half a turn rotations are ambiguous."""

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)

_MIN_INTERVALS = 8
"""Smallest number of sampling intervals of a stretch."""

_CANDIDATES = 4
"""Stretches that are looked at for each that is used; those with the largest motion are used."""

_SCALE_ROWS = 2000
"""Rows of a recording from which the time scale of the motion is computed."""


@dataclass(frozen=True)
class Stretch:
    """Rows [first, last] of a recording."""

    recording: int
    first: int
    last: int


def motion_seconds(dataset: Dataset) -> float:
    """Duration in which motion changes its course: rms position / rms velocity, median over the coordinates [s].

    Velocities are chords over at least 20 ms, which noise disturbs less than differences between neighbours.
    """
    found: list[np.ndarray] = []
    model, longest = dataset.model, _LONGEST
    since = np.arange(model.nv) - model.jnt_dofadr[model.dof_jntid]
    kinds = model.jnt_type[model.dof_jntid]
    turning = (kinds == _BALL) | ((kinds == _FREE) & (since >= 3))
    for recording in dataset.recordings[:12]:
        rows = slice(0, _SCALE_ROWS)
        time, qpos = recording.time[rows], recording.qpos[rows]
        lag = max(1, round(_SHORTEST / float(np.median(np.diff(time)))))
        if len(time) <= 2 * lag:
            continue
        place = difference(recording.model, qpos[:1], qpos)
        chord = difference(recording.model, qpos[:-lag], qpos[lag:]) / (time[lag:] - time[:-lag])[:, None]
        speed = np.sqrt(np.mean(chord**2, axis=0))
        moving = speed > 0
        if turning.any():
            longest = min(longest, _TURN / max(float(np.linalg.norm(speed[turning])), 1e-12))
        found.append((np.std(place, axis=0) / np.where(moving, speed, 1.0))[moving])
    values = np.concatenate(found) if found else np.zeros(0)
    return float(np.clip(1.2 * np.median(values) if len(values) else longest, _SHORTEST, max(longest, _SHORTEST)))


def choose_stretches(dataset: Dataset, seconds: float, count: int, margin: float = 0.0) -> list[Stretch]:
    """Choose stretches without holes, spread evenly over the recordings in proportion to their rows.

    Args:
      dataset: the dataset.
      seconds: length of a stretch [s]; longer where it has fewer than 8 intervals.
      count: number of stretches.
      margin: share of the length that must exist on either side as well.
    """
    total = sum(len(r.time) for r in dataset.recordings)
    out: list[Stretch] = []
    for index, recording in enumerate(dataset.recordings):
        want = max(1, round(count * len(recording.time) / total))
        out += _of_recording(recording, index, seconds, want, margin)
    if len(out) > count:
        out = [out[i] for i in np.linspace(0, len(out) - 1, count).round().astype(int)]
    return out


def _of_recording(recording: Recording, index: int, seconds: float, count: int, margin: float) -> list[Stretch]:
    interval = float(np.median(np.diff(recording.time)))
    length = max(_MIN_INTERVALS, round(seconds / interval))
    side = int(np.ceil(margin * length))
    room = len(recording.time) - length - 2 * side - 1
    if room < 0:
        return []
    # At least half a length apart: stretches that overlap more say the same thing twice.
    candidates = min(_CANDIDATES * count, 2 * room // length + 1)
    firsts = np.unique(np.linspace(side, side + room, candidates).round().astype(int))
    time = recording.time
    even = (time[firsts + length] - time[firsts]) < 1.5 * length * interval
    firsts = firsts[even]
    if not len(firsts):
        return []
    moved = difference(recording.model, recording.qpos[firsts], recording.qpos[firsts + length])
    size = np.abs(moved) / np.maximum(np.sqrt(np.mean(moved**2, axis=0)), 1e-300)
    best = np.sort(np.argsort(-size.sum(axis=1), kind="stable")[:count])
    return [Stretch(index, int(first), int(first) + length) for first in firsts[best]]
