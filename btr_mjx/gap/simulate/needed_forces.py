"""The generalised force that a motion needs beyond what worlds give it: inverse dynamics of many worlds at once.

    F = M(q) a + c(q, v) - tau(q, v, u),

c are Coriolis forces and weight, tau passive forces, actuators, laws and constant wrenches. Unlike accelerations, F is
linear in masses, friction, damping and rotor inertia, however much of these is missing.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from btr_mjx.gap.simulate.batch import batch_blocks, prepared_batch
from btr_mjx.gap.simulate.segments import Controls, Job

_CONSTRAINTS = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
_FRICTION = "dof_frictionloss"


def needed_forces(
    jobs: Sequence[Job], accelerations: Sequence[np.ndarray], length: float, slow: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Forces that motions need beyond those of worlds, and those of actuators.

    Dry friction is at its full size where a joint is fast. Forces of contacts, limits and equality constraints are not
    subtracted: they belong to what is needed.

    Args:
      jobs: (world, segments) pairs, with the states at which forces are taken; sample times have no part in it.
      accelerations: (W, nv) of the motion, for each job.
      length: time from the starts of segments on over which commands are averaged, or in whose middle they are taken
        where they are not held [s].
      slow: (nv,) velocities below which dry friction is not at its full size.

    Returns:
      For each job (W, nv) missing forces and (W, nv) of the actuators [N or N m].
    """
    out = [(np.empty(own.shape), np.empty(own.shape)) for own in accelerations]
    for block in batch_blocks(jobs, length):
        own = prepared_batch(block, jobs, length, 1, _CONSTRAINTS)
        batch = own.batch
        Controls(own.pieces, own.rows, length, own.base.nu, 0.5).write(0, batch.bind("ctrl"))
        smooth, actuator, inertia, velocity = map(batch.bind, ("qfrc_smooth", "qfrc_actuator", "M", "qvel"))
        friction = batch.expand(_FRICTION)
        own.forces.start()
        own.forces.apply()
        batch.forward()
        given = smooth - friction * np.tanh(velocity / slow)
        for (i, a, b), rows in zip(block, own.rows, strict=True):
            out[i][0][a:b] = _product(own.base, inertia[rows], accelerations[i][a:b]) - given[rows]
            out[i][1][a:b] = actuator[rows]
    return out


def _product(model: mujoco.MjModel, inertia: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """(N, nv) product of sparse lower triangles (N, nC) of mass matrices and vectors (N, nv)."""
    out = np.zeros_like(vector)
    for i in range(model.nv):
        for adr in range(model.M_rowadr[i], model.M_rowadr[i] + model.M_rownnz[i]):
            j = int(model.M_colind[adr])
            out[:, i] += inertia[:, adr] * vector[:, j]
            if j != i:
                out[:, j] += inertia[:, adr] * vector[:, i]
    return out
