"""The step of values that an encoder counted."""

import numpy as np

COUNTS = 4096
"""Counts a turn of the encoders of the servos that LeRobot's arms have (Feetech STS, Dynamixel X)."""

_FEWEST = 12
"""Fewest different values that show a step."""
_SMALLEST = 1e-3
"""Smallest step that numbers of 32 bits show beside values of 100; differences below it are rounding."""
_ROUNDING = 0.02
"""Largest distance from a multiple of the step (rms), as a share of it; of values without a step it is 0.29."""
_NEAR = 20
"""Steps between neighbouring values up to which their number is certain at first sight."""


def counted_step(values: np.ndarray) -> float | None:
    """The step of which all differences of values (N,) are multiples; None where there is none, or too few differ."""
    own = np.unique(np.asarray(values, float))
    own = own[np.diff(own, prepend=-np.inf) > _SMALLEST]
    if len(own) < _FEWEST:
        return None
    apart, span = np.diff(own), own[1:] - own[0]
    step = float(np.min(apart))
    near = apart[apart < _NEAR * step]
    step = float(np.sum(near) / np.sum(np.round(near / step)))
    # Over the whole span, an error of the step adds up: it is refined while counts are still certain.
    for reach in np.geomspace(_NEAR * step, max(span[-1], _NEAR * step), 8):
        inside = span[span <= reach]
        if len(inside):
            counts = np.round(inside / step)
            step = float(counts @ inside / (counts @ counts))
    off = span / step - np.round(span / step)
    return step if float(np.sqrt(np.mean(off**2))) < _ROUNDING else None
