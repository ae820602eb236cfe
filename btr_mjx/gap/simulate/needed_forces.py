"""The generalised force that a motion needs beyond what worlds give it: inverse dynamics of many worlds at once.

    F = M(q) a + c(q, v) - tau(q, v, u),

c are Coriolis forces and weight, tau passive forces, actuators, laws and constant wrenches. Unlike accelerations, F is
linear in masses, friction, damping and rotor inertia, however much of these is missing.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from btr_mjx.gap.simulate.forward_dynamics import forward_batches
from btr_mjx.gap.simulate.segments import Job

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
    fields = ("qfrc_smooth", "qfrc_actuator", "M", "qvel")
    for block, own, found in forward_batches(jobs, length, fields, 0.5, _CONSTRAINTS):
        given = found["qfrc_smooth"] - own.batch.expand(_FRICTION) * np.tanh(found["qvel"] / slow)
        for (i, a, b), rows in zip(block, own.rows, strict=True):
            out[i][0][a:b] = _product(own.base, found["M"][rows], accelerations[i][a:b]) - given[rows]
            out[i][1][a:b] = found["qfrc_actuator"][rows]
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
