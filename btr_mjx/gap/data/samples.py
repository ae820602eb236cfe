"""Cleaning of samples: missing values, time stamps, quaternions, estimation of velocities."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import SUFFIXES
from btr_mjx.models import difference, part_names

MAX_MISSING_ROWS = 2
"""Longest run of rows with a missing value that is dropped; a longer run is an error."""
HALF_WIDTH = 3
"""Samples on either side that a velocity estimate uses."""


def complete_rows(
    flat: Mapping[str, np.ndarray], needed: Sequence[str], where: str, notes: list[str], first_row: int = 0
) -> np.ndarray:
    """Indices of the rows without missing values.

    Args:
      flat: (K,) columns by name.
      needed: names of the columns that are checked.
      where: file, for messages.
      notes: the number of dropped rows is appended here.
      first_row: number of rows of the file before these, for messages.

    Returns:
      (N,) row indices.

    Raises:
      InputError: a column without any value, or a run of missing values longer than `MAX_MISSING_ROWS`.
    """
    bad = np.zeros(len(flat["time"]), bool)
    for column in needed:
        missing = ~np.isfinite(flat[column])
        if missing.all():
            raise InputError(f"{where}: column {column!r} holds no finite number")
        edges = np.flatnonzero(np.diff(np.concatenate([[0], missing, [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin > MAX_MISSING_ROWS:
                raise InputError(
                    f"{where}: column {column!r} has no finite value in rows {first_row + begin + 1} to "
                    f"{first_row + end} (time "
                    f"{flat['time'][begin]:.6g} s); cut the recording there into two files"
                )
        bad |= missing
    if bad.any():
        notes.append(f"{int(bad.sum())} rows with missing values dropped")
    return np.flatnonzero(~bad)


def check_time(time: np.ndarray, where: str, first_row: int = 0) -> None:
    """Check that time (K,) [s] increases strictly; `first_row` rows of the file are before it.

    Raises:
      InputError: it does not; the message names the row and both times.
    """
    steps = np.diff(time)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        what = "repeats" if steps[row] == 0 else "goes back"
        raise InputError(
            f"{where}: time {what} from {time[row]:.9g} to {time[row + 1]:.9g} s in row {first_row + row + 2}; it has "
            "to increase: sort the rows and drop duplicates"
        )


def normalise_quaternions(qpos: np.ndarray, model: mujoco.MjModel, where: str) -> None:
    """Normalise the quaternions in qpos (K, nq) in place and make their signs continuous.

    Raises:
      InputError: the norm of a quaternion differs from 1 by more than 0.05.
    """
    for joint, kind in enumerate(model.jnt_type):
        if int(kind) not in SUFFIXES:
            continue
        first = int(model.jnt_qposadr[joint]) + (3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0)
        quat = qpos[:, first : first + 4]
        norm = np.linalg.norm(quat, axis=1)
        if (np.abs(norm - 1) > 0.05).any():
            row = int(np.argmax(np.abs(norm - 1)))
            raise InputError(
                f"{where}: the quaternion of joint {part_names(model, 'joint')[joint]!r} has length {norm[row]:.4g} in "
                f"row {row + 1}; expected 1, in the order qw, qx, qy, qz"
            )
        quat /= norm[:, None]
        flips = np.cumsum(np.sum(quat[1:] * quat[:-1], axis=1) < 0) % 2 == 1
        quat[1:][flips] *= -1


def estimate_velocity(model: mujoco.MjModel, time: np.ndarray, qpos: np.ndarray) -> np.ndarray:
    """Velocities by a least-squares cubic fit to positions, over `HALF_WIDTH` samples on either side.

    Args:
      model: the model.
      time: (K,) [s].
      qpos: (K, nq).

    Returns:
      (K, nv) velocities.
    """
    count = len(time)
    first = np.clip(np.arange(count) - HALF_WIDTH, 0, max(count - 2 * HALF_WIDTH - 1, 0))
    index = np.minimum(first[:, None] + np.arange(2 * HALF_WIDTH + 1), count - 1)  # (K, 2 HALF_WIDTH + 1)
    shift = time[index] - time[:, None]
    scale = np.abs(shift).max(axis=1, keepdims=True)
    weights = np.linalg.pinv((shift / scale)[..., None] ** np.arange(4))[:, 1] / scale  # (K, 2 HALF_WIDTH + 1)
    moves = difference(model, qpos[:, None], qpos[index])
    return np.einsum("ki,kiv->kv", weights, moves)
