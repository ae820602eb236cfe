"""Multi-step rollouts of batches whose worlds have no laws: many steps per call of `mujoco.batch.Batch.rollout`.

Batches are small, so that Python code between single steps would be a noticeable part of the run time.
"""

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from btr_mjx.gap.simulate.segments import BLOCK, Controls, Sampler

_MAX_NUMBERS = 2**22
"""Approximate number of values recorded per call, over all rows and steps; bounds the memory."""

_MOTION = int(mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL)
"""State components that are recorded, in one array."""


def rollout_without_laws(batch: Batch, sampler: Sampler, controls: Controls) -> np.ndarray:
    """Simulate a batch from its start, which is recorded, to the last sample of every row, in blocks of steps.

    Returns:
      (rows,) number of steps taken. A row for which MuJoCo warned or failed is reset to the start of the block and has
      to be continued in single steps.
    """
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    most = max(1, min(BLOCK, _MAX_NUMBERS // max(1, qpos.size + qvel.size)))
    done, held = np.zeros(len(qpos), int), np.zeros(len(qpos), bool)
    for end in np.unique(sampler.steps):
        first = int(done[~held].max(initial=0))
        while first < end:
            own = np.flatnonzero((sampler.steps > first) & ~held).astype(np.int32)
            if not len(own):
                break
            length = int(min(most, end - first))
            state, warned = batch.state[own], batch.warning[own]
            before = np.concatenate([qpos[own], qvel[own]], 1)
            states = np.empty((len(own), length, before.shape[1]))
            given = controls.block(first, length)
            if given is not None and len(own) < len(given):
                given = given[own]
            stopped = np.zeros(len(own), bool)
            try:
                batch.rollout(length, given, record=(_MOTION,), ids=own, out={_MOTION: states})
            except SimulationError as error:
                stopped |= np.isin(own, error.ids)
            stopped |= (batch.warning[own] != warned).reshape(len(own), -1).any(1)
            if stopped.any():
                batch.state[own[stopped]] = state[stopped]
                held[own[stopped]] = True
                own, before, states = own[~stopped], before[~stopped], states[~stopped]
            sampler.take(first, own, before, states)
            first += length
            done[own] = first
    return done
