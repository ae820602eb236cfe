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
        track = _followed(*_straight(times, polynomial[:, :, column]), float(rate[column]))
        if track is not None:
            limited[column] = track
    if not limited:
        return times, polynomial
    union = np.unique(np.concatenate([times, *(t for t, _ in limited.values())]))
    piece = np.clip(np.searchsorted(times, union, side="right") - 1, 0, len(times) - 1)
    out = _moved(polynomial[:, piece], (union - times[piece])[:, None])
    if len(out) < 2:
        out = np.concatenate([out, np.zeros_like(out)])
    for column, (t, y) in limited.items():
        value = np.interp(union, t, y)
        out[:, :, column] = 0.0
        out[0, :, column] = value
        out[1, :-1, column] = np.diff(value) / np.diff(union)
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


def _followed(starts: np.ndarray, begin: np.ndarray, end: np.ndarray, rate: float) -> tuple[np.ndarray, ...] | None:
    """Corners of the response, times and values; None where the command is nowhere faster than the limit."""
    near = _NEAR * max(float(np.ptp(begin)), 1e-300)
    length = np.append(np.diff(starts), np.inf)
    slope = (end - begin) / length
    jumps = np.append(False, np.abs(begin[1:] - end[:-1]) > near)
    fast = np.flatnonzero(jumps | (np.abs(slope) > rate * (1 + 1e-9)))
    if not len(fast):
        return None
    t, y = [float(starts[0])], [float(begin[0])]
    k, now = 0, float(begin[0])
    while k < len(starts):
        if abs(now - begin[k]) <= near:  # it follows up to the next piece that is too fast
            ahead = np.searchsorted(fast, k)
            after = int(fast[ahead]) if ahead < len(fast) else len(starts)
            if after > k:
                t += starts[k + 1 : after + 1].tolist()
                y += end[k : min(after, len(starts) - 1)].tolist()
                k, now = after, float(end[after - 1])
                continue
        now = _chase(float(starts[k]), float(length[k]), float(begin[k]), float(slope[k]), now, rate, t, y)
        k += 1
    return np.array(t), np.array(y)


def _chase(
    start: float, length: float, command: float, slope: float, now: float, rate: float, t: list[float], y: list[float]
) -> float:
    """Move at the limit over one piece, and with the command from where it is met; returns the value at its end."""
    away = command - now
    if away == 0.0:
        away = slope  # it begins to lag behind
    speed = rate if away > 0 else -rate
    meets = (command - now) / (speed - slope) if speed != slope else np.inf
    if 0.0 < meets < length:
        now += speed * meets
        t.append(start + meets)
        y.append(now)
        if not np.isfinite(length):
            return now
        speed, length = (slope if abs(slope) <= rate else rate * np.sign(slope)), length - meets
        start += meets
    if not np.isfinite(length):
        return now
    now += speed * length
    t.append(start + length)
    y.append(now)
    return now
