"""Which moments of the recordings are worth a window: those that together hold much of everything that happens.

Evenly spread windows may miss the few moments in which a motor reaches its limit or a foot the ground. What counts is
what the robot does, never how badly the model follows: windows in which it errs would be chosen for their noise, too.
"""

import numpy as np
from mujoco.batch import Batch

from btr_mjx.gap.simulate import Counter, World
from btr_mjx.gap.windows.prepared import Data
from btr_mjx.runs import available_cores

_TOUCH = 0.15
"""Weight of a contact that is felt at one degree of freedom; of a speed or a motor's force there it is 1. With a weight
of 1 what moves contacts gained two to five times as much as in even windows, and damping and drag half as much."""

_AIR = 8.0
"""Weight of time in which nothing touches: nothing disturbs what drag, gravity and friction do then."""


def bustle(data: Data, counter: Counter) -> list[np.ndarray]:
    """What goes on at every sample, as the believed models see it at the measured states.

    Args:
      data: recordings.
      counter: adds up the simulated steps.

    Returns:
      Per recording (K, 3 nv + 1): squares of speeds and of motors' forces and whether something touches, at every
      degree of freedom, and whether nothing does anywhere.
    """
    out = []
    for recording, track, act in zip(data.recordings, data.tracks, data.acts, strict=True):
        model = recording.model
        batch = Batch(World.of(model).model, nsim=len(track.time), nthread=available_cores())
        batch.bind("qpos")[:] = track.qpos
        batch.bind("qvel")[:] = np.nan_to_num(track.qvel)
        if model.nu:
            batch.bind("ctrl")[:] = recording.ctrl
        if model.na:
            batch.bind("act")[:] = act
        motors, constraints = batch.bind("qfrc_actuator"), batch.bind("qfrc_constraint")
        batch.forward()
        counter.add(len(track.time))
        touch = np.abs(constraints) > 0
        air = ~touch.any(1, keepdims=True)
        parts = np.square(np.nan_to_num(track.qvel)), np.nan_to_num(np.square(motors)), touch, air
        out.append(np.concatenate([np.asarray(part, float) for part in parts], 1))
    return out


def weights(nv: int) -> np.ndarray:
    """(3 nv + 1,) weights of what `bustle` returns."""
    return np.concatenate([np.ones(2 * nv), np.full(nv, _TOUCH), [_AIR]])


def covering(shares: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Choose windows that hold much of everything: greedily, and what is there already counts less.

    The sum over things of the root of how much of it there is grows less with every window that holds the same.

    Args:
      shares: (N, F) how much of each thing every window holds, at least 0.
      weight: (F,) of the things, beside the largest share of each.
      group: (N,) what every window belongs to; each group gets one at least.
      count: windows to choose, at most N.

    Returns:
      Indices, in the order in which they were chosen: `count`, or as many as there are groups.
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
