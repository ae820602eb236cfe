"""Choice of windows that together cover the activity in the recordings: motion, motor forces, contacts.

Evenly spaced windows may miss rare events, such as a motor at its limit or a touchdown. The choice depends on the
measured motion only, not on the residual of the model, which would select windows for their noise.
"""

import numpy as np
from mujoco.batch import Batch

from btr_mjx.gap.simulate import Counter, World
from btr_mjx.gap.windows.prepared import PreparedData
from btr_mjx.gap.windows.rows import row_blocks
from btr_mjx.runs import available_cores

_CONTACT_WEIGHT = 0.15
"""Weight of contact at one degree of freedom, relative to that of speed and of motor force. A larger weight improves
the identification of effects that change contacts at the expense of damping and drag."""

_NO_CONTACT_WEIGHT = 8.0
"""Weight of time without any contact, in which drag, gravity and joint friction act undisturbed."""


def activity(data: PreparedData, counter: Counter) -> list[np.ndarray]:
    """Activity features at every sample, from the believed models at the measured states.

    Args:
      data: recordings.
      counter: adds up the simulated steps.

    Returns:
      Per recording (K, 3 nv + 1): squared velocity (nv), squared actuator force (nv), constraint force present (nv),
      no constraint force at all (1).
    """
    out = []
    for recording, track, act in zip(data.recordings, data.tracks, data.acts, strict=True):
        model = World.of(recording.model).model
        features = np.empty((len(track.time), 3 * model.nv + 1))
        for rows in row_blocks(len(track.time)):
            batch = Batch(model, nsim=rows.stop - rows.start, nthread=available_cores())
            batch.bind("qpos")[:] = track.qpos[rows]
            batch.bind("qvel")[:] = np.nan_to_num(track.qvel[rows])
            if model.nu:
                batch.bind("ctrl")[:] = recording.ctrl[rows]
            if model.na:
                batch.bind("act")[:] = act[rows]
            motors, constraints = batch.bind("qfrc_actuator"), batch.bind("qfrc_constraint")
            batch.forward()
            touch = np.abs(constraints) > 0
            air = ~touch.any(1, keepdims=True)
            parts = np.square(np.nan_to_num(track.qvel[rows])), np.nan_to_num(np.square(motors)), touch, air
            features[rows] = np.concatenate([np.asarray(part, float) for part in parts], 1)
        counter.add(len(track.time))
        out.append(features)
    return out


def activity_weights(nv: int) -> np.ndarray:
    """(3 nv + 1,) weights of the features of `activity`."""
    return np.concatenate([np.ones(2 * nv), np.full(nv, _CONTACT_WEIGHT), [_NO_CONTACT_WEIGHT]])


def greedy_cover(shares: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Greedy maximisation of the concave coverage sum_f sqrt(sum_i w_f s_if / max_i s_if) over chosen windows i.

    The objective is submodular: features that are covered already count less.

    Args:
      shares: (N, F) amount of each feature in each window, at least 0.
      weight: (F,) weights w of the features.
      group: (N,) group of each window; at least one window of each group is chosen.
      count: number of windows to choose, at most N.

    Returns:
      Indices in the order of choice: `count`, or the number of groups if that is larger.
    """
    scaled = weight * shares / np.maximum(shares.max(0), 1e-300)
    held, free = np.zeros(scaled.shape[1]), np.ones(len(scaled), bool)
    missing = set(group.tolist())
    chosen: list[int] = []
    while missing or len(chosen) < count:
        allowed = free & np.isin(group, list(missing)) if missing else free
        gain = (np.sqrt(held + scaled) - np.sqrt(held)).sum(1)
        best = int(np.argmax(np.where(allowed, gain, -1.0)))
        chosen.append(best)
        free[best] = False
        missing.discard(int(group[best]))
        held += scaled[best]
    return np.array(chosen)
