"""Rows of arrays of the same shape, each from the one it is chosen of."""

from collections.abc import Sequence

import numpy as np


def picked(own: np.ndarray, others: Sequence[np.ndarray], chosen: np.ndarray) -> np.ndarray:
    """Rows of some arrays (W, ...): those of `others[i - 1]` where `chosen` (W,) is i, own ones where it is 0.

    Where all are of one array it is that, not a copy of it: some are large.
    """
    used = {int(i): (own, *others)[i] for i in np.unique(chosen)}
    first = next(iter(used.values()))
    if all(array is first for array in used.values()):
        return first
    out = own.copy()
    for i, array in used.items():
        out[chosen == i] = array[chosen == i]
    return out
