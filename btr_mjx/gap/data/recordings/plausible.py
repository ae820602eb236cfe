"""Checks that times and numbers of a recording have plausible sizes: work and memory grow with them."""

from collections.abc import Mapping, Sequence

import numpy as np

from btr_mjx.errors import InputError

LARGEST_MEASURED = 1e12
"""Largest measured number in SI units."""
MOST_EMPTY = 100
"""Largest ratio of a recording's duration to what its rows cover at their median interval. Every check that samples
evenly takes memory in proportion to it."""
LONGEST_INTERVAL = 1000.0
"""Longest median interval between samples [s]."""


def check_span(time: np.ndarray, where: str) -> None:
    """Refuse times (K,) that are no seconds, by `LONGEST_INTERVAL`, and gaps out of proportion, by `MOST_EMPTY`."""
    if len(time) < 2:
        return
    with np.errstate(over="ignore"):
        steps = np.diff(time)
        usual, span = float(np.median(steps)), float(time[-1] - time[0])
    if not usual <= LONGEST_INTERVAL:
        unit = "nanoseconds" if usual >= 1e5 else "microseconds"
        raise InputError(
            f"{where}: samples are {usual:.6g} s apart, which looks like {unit}; the column time is in seconds"
        )
    if span > MOST_EMPTY * usual * len(time):
        row = int(np.argmax(steps))
        raise InputError(
            f"{where}: time jumps from {time[row]:.9g} to {time[row + 1]:.9g} s in row {row + 2}, and samples are "
            f"{usual:.3g} s apart elsewhere; correct the time stamp, or cut the recording there into two files"
        )


def check_sizes(columns: Mapping[str, np.ndarray], needed: Sequence[str], where: str) -> None:
    """Refuse numbers beyond `LARGEST_MEASURED`."""
    for name in needed:
        bad = np.abs(columns[name]) > LARGEST_MEASURED
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{where}: column {name!r} holds {columns[name][row]:g} in row {row + 1}; expected at most "
                f"{LARGEST_MEASURED:g}, in SI units"
            )
