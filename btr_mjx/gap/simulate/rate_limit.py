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
    corners: list[Corner] = []
    k, now = 0, float(begin[0])
    while k < len(starts):
        if abs(now - begin[k]) <= near and abs(slope[k]) <= rate * (1 + 1e-9):
            ahead = np.searchsorted(fast, k + 1)
            after = int(fast[ahead]) if ahead < len(fast) else len(starts)
            corners.append((float(starts[k]), float(begin[k]), True))
            k, now = after, float(end[after - 1])
            continue
        away = begin[k] - now if abs(begin[k] - now) > near else slope[k]
        sign = 1.0 if away > 0 else -1.0
        corners.append((float(starts[k]), now, False))
        reached = now + sign * rate * (starts[k:] - starts[k])
        ahead_at_start = sign * (begin[k:] - reached)
        ahead_at_end = sign * (end[k:] - reached) - rate * length[k:]
        passed = ahead_at_end <= 0
        passed[1:] |= ahead_at_start[1:] < 0  # a jump of the command to the other side
        j = int(np.argmax(passed))
        now, k = float(reached[j]), k + j
        if j and ahead_at_start[j] < 0:
            continue
        since = float(max(ahead_at_start[j], 0.0) / (rate - sign * slope[k]))
        follows = bool(abs(slope[k]) <= rate)
        met = (float(starts[k]) + since, now + sign * rate * since, follows)
        corners.append(met)
        now = float(end[k]) if follows else met[1] - sign * rate * float(length[k] - since)
        k += 1
    return corners
