"""Selection of rows from several arrays of equal shape, and blocks of rows."""

from collections.abc import Iterator, Sequence

import numpy as np

MAX_BATCH = 2048
"""Largest number of samples that are evaluated at once; bounds the memory, as each has an `mjData` of its own."""


def select_rows(own: np.ndarray, others: Sequence[np.ndarray], chosen: np.ndarray) -> np.ndarray:
    """Rows of arrays (W, ...): of `own` where `chosen` is 0, of `others[i - 1]` where it is i.

    Args:
      own: (W, ...).
      others: arrays of the same shape.
      chosen: (W,) integers.

    Returns:
      (W, ...); the array itself, not a copy, if all rows are of one array.
    """
    arrays = (own, *others)
    shares = np.bincount(chosen, minlength=len(arrays))
    most = arrays[int(np.argmax(shares))]
    rest = [i for i in np.flatnonzero(shares) if arrays[i] is not most]
    if not rest:
        return most
    out = most.copy()
    for i in rest:
        rows = np.flatnonzero(chosen == i)
        out[rows] = arrays[i][rows]
    return out


def row_blocks(count: int) -> Iterator[slice]:
    """Blocks of at most `MAX_BATCH` of `count` rows, in order."""
    for first in range(0, count, MAX_BATCH):
        yield slice(first, min(first + MAX_BATCH, count))
