"""The generalised force that a model lacks along recordings, by inverse dynamics, and drives fitted to it.

    r = ID(q, v, a) - tau_actuators(q, v, u)

It is linear in friction, damping and rotor inertia however large these are, unlike accelerations: a wrist whose rotor
weighs a thousand times its link has no linear picture there. This is the usual identification of arms (inverse
dynamic identification model; Gautier 1997). It serves as a start: what is fitted and judged are measurements.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from btr_mjx.gap.forces.stretches import Stretches
from btr_mjx.gap.simulate import needed_forces
from btr_mjx.gap.windows import MakeWorld
from btr_mjx.models import between

_SLOW = 0.05
"""Part of the usual speed below which dry friction is not at its full size."""

_UNCERTAIN = 0.05
"""Part by which the torque constant of a motor may be wrong."""


_AVERAGED = 0.1
"""Time over which forces are averaged where commands are compared with what a motion needs [s]."""


@dataclass(frozen=True, eq=False)
class MissingForce:
    """Missing force in the middle of all intervals.

    Attributes:
      force: (S, K, nv) generalised force that the model lacks [N or N m].
      actuator: (S, K, nv) generalised force of the actuators.
      velocity: (S, K, nv).
      acceleration: (S, K, nv).
    """

    force: np.ndarray
    actuator: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


def missing_force(stretches: Stretches, make: MakeWorld) -> MissingForce:
    """Inverse dynamics of a hypothesis in the middle of all intervals, from smoothed states.

    Args:
      stretches: with smoothed states.
      make: the hypothesis.
    """
    interval = np.diff(stretches.time, axis=1)
    length, shape = float(np.median(interval)), (*interval.shape, stretches.qvel.shape[-1])
    force, actuator = np.empty(shape), np.empty(shape)
    velocity = 0.5 * (stretches.qvel[:, 1:] + stretches.qvel[:, :-1])
    acceleration = np.diff(stretches.qvel, axis=1) / interval[..., None]
    slow = _SLOW * np.sqrt((velocity**2).mean((0, 1))) + 1e-12
    start = stretches.qpos[:, :-1], stretches.qvel[:, :-1]
    for own, model, segments in stretches.segments(slice(-1), *start, np.zeros(interval.shape)):
        ends = [x[own][:, 1:].reshape(-1, x.shape[-1]) for x in (stretches.qpos, stretches.qvel)]
        half = np.full(len(segments), 0.5)
        qpos, qvel = between(model, (segments.qpos, segments.qvel), (ends[0], ends[1]), half, length)
        at, rate = replace(segments, qpos=qpos, qvel=qvel), acceleration[own].reshape(qvel.shape)
        ((missing, driven),) = needed_forces([(make(model), at)], [rate], length, slow)
        force[own], actuator[own] = (x.reshape(len(own), *shape[1:]) for x in (missing, driven))
    return MissingForce(force, actuator, velocity, acceleration)


def drives(missing: MissingForce, spring: np.ndarray | None = None) -> np.ndarray:
    """Friction, damping, rotor inertia and an offset of every degree of freedom, by least squares on missing force.

    Args:
      missing: the force that the model lacks.
      spring: (S, K, nv) force of a unit of stiffness of servos whose stiffness is missing; None where it is believed.

    Returns:
      (5, nv) dry friction, damping, inertia, none below 0, a constant force, and units of stiffness or a change of the
      motor's strength.
    """
    nv = missing.force.shape[-1]
    out = np.zeros((5, nv))
    for j in range(nv):
        force, v, a = (x[..., j].ravel() for x in (missing.force, missing.velocity, missing.acceleration))
        motor = (missing.actuator if spring is None else spring)[..., j].ravel()
        slow = _SLOW * np.sqrt((v**2).mean()) + 1e-12
        columns = np.stack([-np.tanh(v / slow), -v, -a, np.ones_like(v), motor], 1)
        scale = np.sqrt((columns**2).mean(0)) + 1e-12
        # The torque constant is uncertain by some percent: without it inertia and friction would take its part.
        low, high = (-_UNCERTAIN * scale[4], _UNCERTAIN * scale[4] + 1e-12) if spring is None else (0.0, np.inf)
        found = scipy.optimize.lsq_linear(columns / scale, force, ([0, 0, 0, -np.inf, low], [*4 * [np.inf], high]))
        out[:, j] = found.x / scale
    return out


def commanded_share(missing: MissingForce, interval: float) -> np.ndarray:
    """Squared correlation (nv,) of the force of the actuators with the force that the motion needs.

    Args:
      missing: along a motion.
      interval: between its samples [s].
    """
    needed, given = (_averaged(own, interval) for own in (missing.force + missing.actuator, missing.actuator))
    needed, given = needed - needed.mean(0), given - given.mean(0)
    return (needed * given).sum(0) ** 2 / np.maximum((needed**2).sum(0) * (given**2).sum(0), 1e-300)


def _averaged(force: np.ndarray, interval: float) -> np.ndarray:
    """(N, nv) means of forces (S, K, nv) over `_AVERAGED`: accelerations from sample to sample are mostly noise."""
    width = int(np.clip(round(_AVERAGED / interval), 1, force.shape[1]))
    blocks = force[:, : force.shape[1] // width * width].reshape(len(force), -1, width, force.shape[-1])
    return blocks.mean(2).reshape(-1, force.shape[-1])
