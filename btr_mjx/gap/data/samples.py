"""Samples as they come out of a file: holes, clocks, quaternions, velocities that were not measured."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import SUFFIXES
from btr_mjx.models import difference, part_names

MAX_HOLE = 2
"""Rows with a missing value are dropped if no more than so many follow each other."""
SPAN = 3
"""Velocities are estimated from so many samples on either side."""


def sound_rows(flat: Mapping[str, np.ndarray], needed: Sequence[str], where: str, notes: list[str]) -> np.ndarray:
    """Indices of the rows without missing values.

    Args:
      flat: (K,) columns by name.
      needed: names of those that matter.
      where: file, for messages.
      notes: what was done is added here.

    Raises:
      InputError: a column without any value, or a run of missing ones.
    """
    bad = np.zeros(len(flat["time"]), bool)
    for column in needed:
        missing = ~np.isfinite(flat[column])
        if missing.all():
            raise InputError(f"{where}: column {column!r} holds no finite number")
        edges = np.flatnonzero(np.diff(np.concatenate([[0], missing, [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin > MAX_HOLE:
                raise InputError(
                    f"{where}: column {column!r} has no finite value in rows {begin + 1} to {end} (time "
                    f"{flat['time'][begin]:.6g} s); cut the recording there into two files"
                )
        bad |= missing
    if bad.any():
        notes.append(f"{int(bad.sum())} rows with missing values dropped")
    return np.flatnonzero(~bad)


def check_time(time: np.ndarray, where: str) -> None:
    """Refuse time that does not increase.

    Raises:
      InputError: names the row and both times.
    """
    steps = np.diff(time)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        what = "repeats" if steps[row] == 0 else "goes back"
        raise InputError(
            f"{where}: time {what} from {time[row]:.9g} to {time[row + 1]:.9g} s in row {row + 2}; it has to increase: "
            "sort the rows and drop duplicates"
        )


def normalise(qpos: np.ndarray, model: mujoco.MjModel, where: str) -> None:
    """Scale quaternions to unit length in place and keep their sign from jumping.

    Raises:
      InputError: a quaternion of quite another length.
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
    """Velocities from positions by a local cubic over `SPAN` samples on either side.

    Args:
      model: the model.
      time: (K,) [s].
      qpos: (K, nq).

    Returns:
      (K, nv).
    """
    count = len(time)
    first = np.clip(np.arange(count) - SPAN, 0, max(count - 2 * SPAN - 1, 0))
    index = np.minimum(first[:, None] + np.arange(2 * SPAN + 1), count - 1)  # (K, 2 SPAN + 1)
    shift = time[index] - time[:, None]
    scale = np.abs(shift).max(axis=1, keepdims=True)
    weights = np.linalg.pinv((shift / scale)[..., None] ** np.arange(4))[:, 1] / scale  # (K, 2 SPAN + 1)
    moves = difference(model, qpos[:, None], qpos[index])
    return np.einsum("ki,kiv->kv", weights, moves)
