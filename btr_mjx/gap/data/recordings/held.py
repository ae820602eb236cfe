"""What the samples say of the time between them: columns that repeat, commands like stairs, commands that bend.

A column is held where its changes stand alone: a row that differs from the one before is hardly ever followed by
another such row. Smooth motion changes in every row; a coarse encoder on a slow joint steps by one count at a time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_MAX_ADJACENT = 0.05
"""Largest share of changes that directly follow another one; jitter of two clocks makes a few."""

_TOGETHER = 0.6
"""Columns are held together if they change, on average, in this share of the rows in which any of them does."""

_MIN_CHANGES = 12
"""Fewest changes that show a rate."""

_MIN_COUNTS = 3.0
"""Smallest median size of a change, in units of the smallest one: an encoder that moves by single counts holds
nothing."""


@dataclass(frozen=True)
class Held:
    """Columns that repeat between changes.

    Attributes:
      rows: (N,) rows in which they change, the first one included.
      every: median number of rows between changes.
      coarse: changes are as small as the resolution, so that it may be resolution instead of holding.
    """

    rows: np.ndarray
    every: float
    coarse: bool


def held(columns: np.ndarray, fewest: int = _MIN_CHANGES) -> Held | None:
    """Whether columns (K, n) are held together between changes.

    Args:
      columns: values, one row a sample; columns that never change do not count.
      fewest: changes that are necessary.

    Returns:
      Where they change; None if they are not held.
    """
    steps = np.abs(np.diff(columns, axis=0))
    changed = (steps > 0).any(axis=1)
    rows = np.flatnonzero(changed) + 1
    if len(rows) < fewest or np.mean(np.diff(rows) == 1) > _MAX_ADJACENT:
        return None
    moving = (steps > 0).sum(axis=0)
    if moving[moving > 0].mean() < _TOGETHER * len(rows):
        return None
    sizes = [column[column > 0] for column in steps.T]
    counts = max(np.median(own) / own.min() for own in sizes if len(own))
    return Held(np.concatenate([[0], rows]), float(np.median(np.diff(rows))), bool(counts < _MIN_COUNTS))


def stairs(controls: Sequence[np.ndarray]) -> Held | None:
    """Whether the commands of all recordings are stairs.

    Args:
      controls: (K, nu) of each recording.

    Returns:
      The stairs of the column with the most changes; None if any command changes in consecutive rows, or none changes.
    """
    columns = [column[:, None] for ctrl in controls for column in ctrl.T if np.ptp(column) > 0]
    found = [one for column in columns if (one := held(column, fewest=1)) is not None]
    return max(found, key=lambda one: len(one.rows), default=None) if len(found) == len(columns) else None


def bends(commands: Sequence[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether commands are smooth enough for cubic splines between their samples.

    Every other sample is predicted from the rest: of smooth commands best by a spline, of noisy or broken ones by
    straight lines. Chords of a smooth command are too flat, which looks like a rotor inertia.

    Args:
      commands: times (K,) [s] and values (K, nu) of each recording.
    """
    from scipy.interpolate import CubicSpline  # slow to load

    straight = curved = 0.0
    for times, values in commands:
        spread = np.ptp(values, axis=0)
        kept, left_out = slice(None, None, 2), slice(1, (len(times) - 1) // 2 * 2, 2)
        if len(times[kept]) < 4 or not spread.any():
            continue
        scaled = values[:, spread > 0] / spread[spread > 0]
        chord = np.stack([np.interp(times[left_out], times[kept], column) for column in scaled[kept].T], axis=1)
        spline = CubicSpline(times[kept], scaled[kept])(times[left_out])
        straight += float(((chord - scaled[left_out]) ** 2).sum())
        curved += float(((spline - scaled[left_out]) ** 2).sum())
    return curved < straight
