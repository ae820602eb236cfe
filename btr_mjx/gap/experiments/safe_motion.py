"""Motions that a robot survives: those that stay near where its recordings have been."""

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Recording

_BEYOND = 1.0
"""Reach beyond the recorded range of a coordinate to either side, in units of the range. Commands stay within half a
range; a motion that goes twice as far follows another law, such as falling."""


def stays_near_recordings(motion: Recording, dataset: Dataset) -> bool:
    """Whether joints, and the height and tilt of free bodies, stay near where they have been in the recordings.

    A command without feedback throws a robot that flies or balances: it leaves the range within a second.

    Args:
      motion: simulated.
      dataset: the recordings.
    """
    seen = np.concatenate([_guarded(recording) for recording in dataset.recordings])
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    reach, found = _BEYOND * (high - low), _guarded(motion)
    return bool(np.all((found >= low - reach) & (found <= high + reach) | np.isnan(low)))


def _guarded(recording: Recording) -> np.ndarray:
    """(K, n) Joint positions; of free bodies the height, and of these and of ball joints the tilt [rad]."""
    model, columns = recording.model, []
    up = -model.opt.gravity / max(float(np.linalg.norm(model.opt.gravity)), 1e-12)
    for kind, first in zip(model.jnt_type.tolist(), model.jnt_qposadr.tolist(), strict=True):
        if kind >= int(mujoco.mjtJoint.mjJNT_SLIDE):
            columns.append(recording.qpos[:, first])
            continue
        turn = first
        if kind == int(mujoco.mjtJoint.mjJNT_FREE):
            columns.append(recording.qpos[:, first : first + 3] @ up)
            turn = first + 3
        w, x, y, z = recording.qpos[:, turn : turn + 4].T
        axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
        columns.append(np.arccos(np.clip(axis @ up, -1.0, 1.0)))
    return np.stack(columns, axis=1)
