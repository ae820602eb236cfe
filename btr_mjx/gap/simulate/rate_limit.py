"""Rate limit of a piecewise polynomial command: |dy/dt| <= rate, solved piece by piece.

Where the command is slower than the limit, y follows it; where it is faster or jumps, y moves at the limit until it
meets the command again. Between two breakpoints the command is taken as linear, in a few parts where it is curved.
"""

from math import comb

import numpy as np

_PARTS = 4
"""Straight parts of a piece that is curved."""

_NEAR = 1e-9
"""Distance, relative to the range of the command, at which the command is met."""


def rate_limited(times: np.ndarray, polynomial: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The response of rate limits.

    Args:
      times: (K,) starts of the pieces [s]; the last piece is constant.
      polynomial: (order, K, nu) coefficients of the command in the time since the start of a piece, lowest first.
      rate: (nu,) largest rate of each control [1/s]; inf for none.

    Returns:
      Starts of pieces (M,) and coefficients (order, M, nu) of the response. The same objects where no limit is reached.
    """
    limited = {}
    for column in np.flatnonzero(np.isfinite(rate)).tolist():
        corners = _followed(*_straight(times, polynomial[:, :, column]), float(rate[column]))
        if corners is not None:
            limited[column] = corners
    if not limited:
        return times, polynomial
    union = np.unique(np.concatenate([times, *([t for t, _, _ in corners] for corners in limited.values())]))
    piece = np.clip(np.searchsorted(times, union, side="right") - 1, 0, len(times) - 1)
    out = _moved(polynomial[:, piece], (union - times[piece])[:, None])
    if len(out) < 2:
        out = np.concatenate([out, np.zeros_like(out)])
    for column, corners in limited.items():
        t, y, follows = (np.array(x) for x in zip(*corners, strict=True))
        corner = np.clip(np.searchsorted(t, union, side="right") - 1, 0, len(t) - 1)
        line = ~follows[corner]
        slope = np.diff(y, append=y[-1]) / np.maximum(np.diff(t, append=np.inf), 1e-300)
        out[:, line, column] = 0.0
        out[0, line, column] = (y[corner] + slope[corner] * (union - t[corner]))[line]
        out[1, line, column] = slope[corner][line]
    return union, out


def _moved(polynomial: np.ndarray, since: np.ndarray) -> np.ndarray:
    """Coefficients (order, M, nu) of polynomials in the time since a later start (M, 1)."""
    order = len(polynomial)
    rows = [
        sum((comb(i, j) * polynomial[i] * since ** (i - j) for i in range(j, order)), np.zeros_like(polynomial[0]))
        for j in range(order)
    ]
    return np.stack(rows)


def _straight(times: np.ndarray, polynomial: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A control (order, K) as straight pieces: starts (M + 1,), values at the start and at the end of each (M,)."""
    parts = _PARTS if len(polynomial) > 2 else 1
    length = np.diff(times) / parts
    since = length[:, None] * np.arange(parts + 1)  # (K - 1, parts + 1)
    value = np.zeros_like(since)
    for coefficient in polynomial[::-1, :-1]:
        value = value * since + coefficient[:, None]
    starts = np.append((times[:-1, None] + since[:, :-1]).ravel(), times[-1])
    # The last value is where a held command jumps to at the end.
    begin, end = np.append(value[:, :-1].ravel(), polynomial[0, -1]), np.append(value[:, 1:].ravel(), polynomial[0, -1])
    return starts, begin, end


Corner = tuple[float, float, bool]
"""Time, value of the response there, and whether it follows the command up to the next corner."""


def _followed(starts: np.ndarray, begin: np.ndarray, end: np.ndarray, rate: float) -> list[Corner] | None:
    """Corners of the response to straight pieces; None where the command is nowhere faster than the limit."""
    near = _NEAR * max(float(np.ptp(begin)), 1e-300)
    length = np.append(np.diff(starts), np.inf)
    slope = (end - begin) / length
    jumps = np.append(False, np.abs(begin[1:] - end[:-1]) > near)
    fast = np.flatnonzero(jumps | (np.abs(slope) > rate * (1 + 1e-9)))
    if not len(fast):
        return None
    # Numbers of Python: a piece at a time, they are ten times as fast as arrays.
    pieces = list(zip(*(x.tolist() for x in (starts, length, begin, end, slope)), strict=True))
    corners: list[Corner] = []
    k, now, moving, count = 0, pieces[0][2], 0.0, len(pieces)
    while k < count:
        start, lasts, first, last, tilt = pieces[k]
        away = first - now
        if -near <= away <= near:
            if abs(tilt) <= rate * (1 + 1e-9):
                ahead = np.searchsorted(fast, k + 1)
                after = int(fast[ahead]) if ahead < len(fast) else count
                corners.append((start, first, True))
                k, now, moving = after, pieces[after - 1][3], 0.0
                continue
            away = tilt
        sign = 1.0 if away > 0 else -1.0
        if sign != moving:  # a line goes on over as many pieces as it takes
            corners.append((start, now, False))
            moving = sign
        k += 1
        if sign * (last - now) > rate * lasts:
            now += sign * rate * lasts
            continue
        since = max(sign * (first - now), 0.0) / (rate - sign * tilt)
        follows = abs(tilt) <= rate
        met = now + sign * rate * since
        corners.append((start + since, met, follows))
        now = last if follows else met - sign * rate * (lasts - since)
        moving = 0.0 if follows else -sign
    return corners
