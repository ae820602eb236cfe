"""Where a robot that touches next to nothing bumps into something all the same: an end stop, an obstacle, itself.

Its windows are long, for what is slow. A blow in one of them multiplies what a starting state, a time step or a small
effect do before it, so that one blow can outweigh all that goes on elsewhere: a cart that lacked nothing had 8 and 15
times its noise in the two windows in which it ran into its end stop hard. Windows lie between the blows, therefore.
"""

import mujoco
import numpy as np
from mujoco.batch import Batch

from btr_mjx.gap.simulate import Counter, World
from btr_mjx.gap.windows.prepared import Data
from btr_mjx.runs import available_cores

_SIGMAS = 3.0
"""A joint this close to its end stop, in units of the noise, stands at it."""


def touching_samples(data: Data, counter: Counter) -> tuple[np.ndarray, ...]:
    """Per recording (K,) bool: something touches, as the believed models see it at the measured states."""
    out = []
    for recording, track in zip(data.recordings, data.tracks, strict=True):
        world = World.of(recording.model)
        batch = Batch(world.model, nsim=len(track.time), nthread=available_cores())
        batch.bind("qpos")[:] = track.qpos
        count = batch.bind("ncon")
        batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_POS))
        counter.add(len(track.time))
        out.append(np.array(count).reshape(-1) > 0)
    return tuple(out)


def stopped(data: Data) -> tuple[np.ndarray, ...]:
    """Per recording (K, L) bool: which of L joints that have end stops stand at one."""
    out = []
    for recording, track in zip(data.recordings, data.tracks, strict=True):
        model = recording.model
        single = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
        joints = np.flatnonzero(model.jnt_limited.astype(bool) & single)
        slack = _SIGMAS * data.sigma[model.jnt_dofadr[joints]] + model.jnt_margin[joints]
        low, high = model.jnt_range[joints].T
        position = track.qpos[:, model.jnt_qposadr[joints]]
        out.append((position < low + slack) | (position > high - slack))
    return tuple(out)


def blows(data: Data, counter: Counter) -> tuple[np.ndarray, ...]:
    """Per recording (K,) bool: samples at which something touches, or a joint comes to an end stop or leaves it."""
    out = []
    for touching, at_stop in zip(touching_samples(data, counter), stopped(data), strict=True):
        changes = np.zeros(len(touching), bool)
        turned = (at_stop[1:] != at_stop[:-1]).any(1)
        changes[1:] |= turned
        changes[:-1] |= turned
        out.append(touching | changes)
    return tuple(out)


def quiet_windows(blow: np.ndarray, first: int, last: int, k: int) -> np.ndarray:
    """First samples of windows that do not overlap and hold no blow, as many as there is room for.

    Args:
      blow: (K,) bool.
      first: the earliest sample that a window may start at.
      last: the latest.
      k: samples of a window after its first.
    """
    out: list[np.ndarray] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[True], blow, [True]]).astype(int)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):  # samples start to end - 1 hold no blow
        low, high = max(int(start), first), min(int(end) - 1 - k, last)
        if high >= low:
            out.append(np.unique(np.linspace(low, high, (high - low) // k + 1).astype(int)))
    return np.concatenate(out) if out else np.zeros(0, int)
