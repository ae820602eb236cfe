"""Velocities: by how much measured ones lag the positions, and estimates from positions."""

from collections.abc import Sequence

import mujoco
import numpy as np

from btr_mjx.models import difference

HALF_WIDTH = 3
"""Samples on either side that a velocity estimate uses."""
_SIGNIFICANT = 6.0
"""Standard errors by which a lag has to differ from none."""
_MIN_WINDOWS = 20
"""Fewest displacements that can show a lag."""


def velocity_lag(tracks: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> float:
    """Time by which the measured velocity of a hinge or slide lags the slope of its positions.

    A velocity v that went through a low-pass of the first order with time constant T satisfies q' = v + T v', so that a
    displacement is the integral of v plus T times the change of v; a delay by T does so nearly.

    Args:
      tracks: times (K,) [s], positions (K,) and velocities (K,) of each recording.

    Returns:
      T [s], negative for a lead; 0 where it is within one sampling interval or cannot be told from none: half an
      interval, or half a time step of the simulation, is usual.
    """
    interval = float(np.median(np.concatenate([np.diff(time) for time, _, _ in tracks])))
    best, lag = 0.0, 0.0
    for length in 2 ** np.arange(1, 12):
        rows = []
        for time, position, velocity in tracks:
            integral = np.cumsum([0, *(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
            rows.append(np.stack([np.diff(x[::length]) for x in (position, integral, velocity)], axis=1))
        moved, *columns = np.concatenate(rows).T
        matrix = np.stack(columns, axis=1)
        if len(moved) < _MIN_WINDOWS or np.linalg.matrix_rank(matrix) < 2:
            break
        (scale, late), left = np.linalg.lstsq(matrix, moved)[:2]
        error = np.sqrt(left[0] / (len(moved) - 2) * np.linalg.inv(matrix.T @ matrix)[1, 1])
        strength = abs(late) / max(float(error), 1e-300)
        if 0.5 < scale < 2 and strength > max(best, _SIGNIFICANT):
            best, lag = strength, float(late / scale)
    return lag if abs(lag) > interval else 0.0


def estimate_velocity(model: mujoco.MjModel, time: np.ndarray, qpos: np.ndarray) -> np.ndarray:
    """Velocities (K, nv) by cubic fits to `HALF_WIDTH` positions (K, nq) before and after each time (K,) [s]."""
    count = len(time)
    first = np.clip(np.arange(count) - HALF_WIDTH, 0, max(count - 2 * HALF_WIDTH - 1, 0))
    index = np.minimum(first[:, None] + np.arange(2 * HALF_WIDTH + 1), count - 1)  # (K, 2 HALF_WIDTH + 1)
    shift = time[index] - time[:, None]
    scale = np.abs(shift).max(axis=1, keepdims=True)
    weights = np.linalg.pinv((shift / scale)[..., None] ** np.arange(4))[:, 1] / scale  # (K, 2 HALF_WIDTH + 1)
    moves = difference(model, qpos[:, None], qpos[index])
    return np.einsum("ki,kiv->kv", weights, moves)
