"""Impacts of a robot that is mostly free of contact: end stops, obstacles, self-collision.

Windows of such a robot are long. An impact amplifies errors of the starting state and of the time step and can dominate
the residual of its window; windows are therefore placed between impacts.
"""

import mujoco
import numpy as np
from mujoco.batch import Batch

from btr_mjx.gap.simulate import Counter, World
from btr_mjx.gap.windows.prepared import PreparedData
from btr_mjx.gap.windows.rows import row_blocks
from btr_mjx.runs import available_cores

_STOP_SIGMAS = 3.0
"""Distance to its limit within which a joint is at its end stop, in standard deviations of the noise."""


def contact_samples(data: PreparedData, counter: Counter) -> tuple[np.ndarray, ...]:
    """Per recording (K,) bool: the believed model has a contact at the measured configuration."""
    out = []
    for recording, track in zip(data.recordings, data.tracks, strict=True):
        world, touching = World.of(recording.model), np.zeros(len(track.time), bool)
        for rows in row_blocks(len(track.time)):
            batch = Batch(world.model, nsim=rows.stop - rows.start, nthread=available_cores())
            batch.bind("qpos")[:] = track.qpos[rows]
            count = batch.bind("ncon")
            batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_POS))
            touching[rows] = np.array(count).reshape(-1) > 0
        counter.add(len(track.time))
        out.append(touching)
    return tuple(out)


def at_end_stops(data: PreparedData) -> tuple[np.ndarray, ...]:
    """Per recording (K, L) bool: which of the L limited joints are at an end stop."""
    out = []
    for recording, track in zip(data.recordings, data.tracks, strict=True):
        model = recording.model
        single = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
        joints = np.flatnonzero(model.jnt_limited.astype(bool) & single)
        slack = _STOP_SIGMAS * data.sigma[model.jnt_dofadr[joints]] + model.jnt_margin[joints]
        low, high = model.jnt_range[joints].T
        position = track.qpos[:, model.jnt_qposadr[joints]]
        out.append((position < low + slack) | (position > high - slack))
    return tuple(out)


def impact_samples(data: PreparedData, counter: Counter) -> tuple[np.ndarray, ...]:
    """Per recording (K,) bool: samples with a contact, or at which a joint reaches or leaves an end stop."""
    out = []
    for touching, at_stop in zip(contact_samples(data, counter), at_end_stops(data), strict=True):
        changes = np.zeros(len(touching), bool)
        turned = (at_stop[1:] != at_stop[:-1]).any(1)
        changes[1:] |= turned
        changes[:-1] |= turned
        out.append(touching | changes)
    return tuple(out)


def impact_free_windows(impact: np.ndarray, first: int, last: int, k: int) -> np.ndarray:
    """First samples of the largest set of windows that do not overlap and contain no impact.

    Args:
      impact: (K,) bool: samples with an impact.
      first: earliest first sample of a window.
      last: latest first sample of a window.
      k: samples of a window after its first.

    Returns:
      (N,) ascending sample indices.
    """
    out: list[np.ndarray] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[True], impact, [True]]).astype(int)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):  # samples start to end - 1 are free of impacts
        low, high = max(int(start), first), min(int(end) - 1 - k, last)
        if high >= low:
            out.append(np.unique(np.linspace(low, high, (high - low) // k + 1).astype(int)))
    return np.concatenate(out) if out else np.zeros(0, int)
