"""Rows of arrays of the same shape, each from the one it is chosen of."""

from collections.abc import Sequence

import numpy as np


def picked(own: np.ndarray, others: Sequence[np.ndarray], chosen: np.ndarray) -> np.ndarray:
    """Rows of some arrays (W, ...): those of `others[i - 1]` where `chosen` (W,) is i, own ones where it is 0.

    Where all are of one array it is that, not a copy of it: some are large.
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
