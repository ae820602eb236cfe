"""Steps that ask nothing of Python: worlds without laws run through many of them in one call.

Batches are small, two dozen windows in the mean, and what Python does between two steps costs a tenth of a search.
"""

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from btr_mjx.gap.simulate.stretches import BLOCK, Controls, Sampler

_NUMBERS = 2**22
"""Numbers of all rows and steps that are recorded at once, roughly."""

_MOTION = int(mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL)
"""What is recorded, both in one array: to join them afterwards costs as much as a few steps."""


def freewheel(batch: Batch, sampler: Sampler, controls: Controls) -> np.ndarray:
    """Run a batch to the last sample of every row, as far as nothing happens on the way.

    Args:
      batch: at its start states; nothing but controls changes from step to step.
      sampler: of its rows, with the start recorded.
      controls: of its rows.

    Returns:
      (rows,) steps that each has taken. Where MuJoCo warned or failed a row stays where it was some steps before: what
      it does then is a matter of single steps.
    """
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    most = max(1, min(BLOCK, _NUMBERS // max(1, qpos.size + qvel.size)))
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
