"""Rows of a recording: those with all values, parts between holes, time stamps, quaternions."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import SUFFIXES
from btr_mjx.gap.data.lists import counted, listed
from btr_mjx.gap.data.recordings.clocks import CLOSE, usual_interval
from btr_mjx.gap.data.recordings.noise import DIFFERENCE_ORDER, annihilator
from btr_mjx.models import part_names, sign_flips

MAX_MISSING_ROWS = 2
"""Longest run of rows with a missing value that is dropped; a longer run splits the recording."""
MAX_PARTS = 12
"""Most parts of a recording that is split at holes; the longest are kept. Each costs the search a window."""
_SIGNIFICANT = 6.0
"""Standard errors by which even times have to be better."""
_JITTER = 0.01, 0.5
"""Smallest and largest rms distance between stamps and even times, in intervals: less is the resolution of the stamps,
more is a clock whose rate changes."""
_FOLLOWED = 0.1
"""Share by which a clock that counts samples is moved towards each time stamp."""
_MIN_WINDOWS = 20
"""Fewest stretches that can decide on one of the two."""


def complete_rows(flat: Mapping[str, np.ndarray], needed: Sequence[str], where: str, notes: list[str]) -> np.ndarray:
    """Indices (N,) of the rows in which all `needed` columns (K,) have a value."""
    bad = np.zeros(len(flat["time"]), bool)
    for column in needed:
        missing = ~np.isfinite(flat[column])
        if missing.all():
            raise InputError(f"{where}: column {column!r} holds no finite number")
        bad |= missing
    if bad.all():
        raise InputError(f"{where}: no row has values of all of {listed(needed)}; are their times of one clock?")
    if bad.any():
        notes.append(f"{int(bad.sum())} rows with missing values dropped")
    return np.flatnonzero(~bad)


def whole_parts(rows: np.ndarray, time: np.ndarray, shortest: int, notes: list[str]) -> list[slice]:
    """Parts of a recording without a hole: a run of missing rows, or a gap in time.

    Args:
      rows: (N,) indices of the complete rows.
      time: (N,) their times [s].
      shortest: number of samples; shorter parts are dropped.
      notes: how the recording is split is appended here.

    Returns:
      Slices of the N rows, in the order of time: all parts, or the `MAX_PARTS` longest ones.
    """
    steps = np.diff(time)
    holes = (np.diff(rows) > MAX_MISSING_ROWS + 1) | (steps > CLOSE * usual_interval(time))
    if not holes.any():
        return [slice(0, len(rows))]
    edges = [0, *(np.flatnonzero(holes) + 1).tolist(), len(rows)]
    parts = [slice(begin, end) for begin, end in pairwise(edges)]
    long = [part for part in parts if part.stop - part.start >= shortest]
    kept = sorted(sorted(long, key=lambda part: part.start - part.stop)[:MAX_PARTS], key=lambda part: part.start)
    k = int(np.argmax(np.where(holes, steps, -np.inf)))
    left_out = len(rows) - sum(part.stop - part.start for part in kept)
    text = (
        f"split into {len(kept)} parts at {counted(int(holes.sum()), 'hole')}, the longest from {time[k]:.6g} to "
        f"{time[k + 1]:.6g} s"
    )
    if left_out:
        why = f"parts shorter than {shortest} samples" if len(long) <= MAX_PARTS else f"all but the {MAX_PARTS} longest"
        text += f"; {left_out} of {len(rows)} samples are left out ({why})"
    notes.append(text)
    return kept


def even_times(time: np.ndarray, positions: np.ndarray) -> np.ndarray | None:
    """Even times, where positions (K, n) are smoother as functions of these than of their time stamps (K,) [s].

    Returns:
      (K,) the even times nearest to the stamps; samples may be lost in between. None where the stamps fit better, or
      where the two cannot be told apart.
    """
    steps, order = np.diff(time), DIFFERENCE_ORDER + 1
    if not np.isfinite(time).all() or len(time) < _MIN_WINDOWS * order or (steps <= 0).any():
        return None
    found = []
    for index in (np.arange(len(time)), _counted(time, float(np.median(steps)))):
        times = np.polyval(np.polyfit(index, time - time[0], 1), index) + time[0]
        found.append((float(np.std(times - time)), times))
    off, times = min(found, key=lambda pair: pair[0])
    if not _JITTER[0] < off / float(np.median(steps)) < _JITTER[1]:
        return None
    rows = np.arange(len(time) // order * order).reshape(-1, order)
    rough = np.array([np.einsum("ki,kic->kc", annihilator(x[rows]), positions[rows]) ** 2 for x in (time, times)])
    rough = rough[:, np.isfinite(rough).all(axis=(0, 2))]
    if rough.shape[1] < _MIN_WINDOWS:
        return None
    size = rough.mean(axis=(0, 1))
    stamped, even = (rough[:, :, size > 0] / size[size > 0]).sum(axis=2)
    own = (stamped > 0) & (even > 0) & (stamped != even)
    gain = np.log(stamped[own] / even[own])
    if len(gain) < _MIN_WINDOWS or np.mean(gain) < _SIGNIFICANT * np.std(gain) / np.sqrt(len(gain)):
        return None
    return times


def _counted(time: np.ndarray, interval: float) -> np.ndarray:
    """Numbers (K,) of samples, some of which were lost, by a clock that slowly follows the time stamps."""
    index, clock = np.zeros(len(time), int), float(time[0])
    for k in range(1, len(time)):
        count = round((float(time[k]) - clock) / interval)
        clock += count * interval
        clock += _FOLLOWED * (float(time[k]) - clock)
        index[k] = index[k - 1] + count
    # A stamp that is late by more than half an interval is not a lost sample: the next one is not late as well.
    lost = np.minimum.accumulate((index - np.arange(len(time)))[::-1])[::-1]
    return np.arange(len(time)) + lost


def normalise_quaternions(qpos: np.ndarray, model: mujoco.MjModel, where: str) -> None:
    """Normalise quaternions in qpos (K, nq) in place, with continuous signs; refuses norms that are not near 1."""
    for joint, kind in enumerate(model.jnt_type):
        if int(kind) not in SUFFIXES:
            continue
        first = int(model.jnt_qposadr[joint]) + (3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0)
        quat = qpos[:, first : first + 4]
        norm = np.linalg.norm(quat, axis=1)
        if (np.abs(norm - 1) > 0.05).any():
            row = int(np.argmax(np.abs(norm - 1)))
            raise InputError(
                f"{where}: the quaternion of joint {part_names(model, 'joint')[joint]!r} has length {norm[row]:.4g} in "
                f"row {row + 1}; expected 1, in the order qw, qx, qy, qz"
            )
        quat /= norm[:, None]
        quat *= sign_flips(quat)[:, None]
