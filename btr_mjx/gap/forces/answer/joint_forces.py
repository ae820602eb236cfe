"""The missing force at the joints where most is missing, for a picture of what it depends on."""

import mujoco
import numpy as np

from btr_mjx.gap.effects import LawTerm
from btr_mjx.gap.forces.kalman_filter import smoothed
from btr_mjx.gap.forces.law_scan import JointStates, joint_states
from btr_mjx.gap.forces.points import QUANTILE, Fitted, ForceSide, covariance
from btr_mjx.gap.results import JointForce
from btr_mjx.models import dof_places

_SHOWN = 2
"""Joints that are shown besides those with a law."""

_POINTS = 2000
"""Points of a joint, at most."""


def joint_forces(side: ForceSide, first: Fitted, last: Fitted) -> tuple[JointForce, ...]:
    """Missing force before and after, and what laws say of it.

    Args:
      side: the recordings to fit.
      first: the believed model with calibration.
      last: with all that was named.
    """
    model = side.stretches.data.recordings[0].model
    before, after = map(random_force, (first, last))
    states = joint_states(last.stretches, last.point.hypothesis(side.library))
    scalar = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    usual = np.sqrt((states.load**2).mean((0, 1)) + (before**2).mean((0, 1)) + 1e-300)
    share = np.sqrt((before**2).mean((0, 1))) / usual
    worst = sorted(np.flatnonzero(scalar).tolist(), key=lambda j: -share[model.jnt_dofadr[j]])
    with_law = [c.place.joints[0] for c, _ in last.point.named if c.effect.law is not None]
    places, every, out = dof_places(model), max(1, before[..., 0].size // _POINTS), []
    for joint in dict.fromkeys([*with_law, *worst[:_SHOWN]]):
        dof = int(model.jnt_dofadr[joint])
        law, spread, follows = _of_laws(side, last, states, joint)
        at = states.of(dof, dof)
        few = slice(None, None, every)
        out.append(
            JointForce(
                joint=places[dof][0],
                unit=places[dof][1],
                position=at.q.ravel()[few],
                velocity=at.v.ravel()[few],
                load=at.load.ravel()[few],
                time=at.time.ravel()[few],
                before=before[..., dof].ravel()[few],
                after=after[..., dof].ravel()[few],
                law=law.ravel()[few],
                spread=spread.ravel()[few],
                follows=follows,
            )
        )
    return tuple(out)


def random_force(fit: Fitted) -> np.ndarray:
    """(S, K, nv) force that is missing beside a fit [N or N m]."""
    return smoothed(fit.linear, np.zeros_like(fit.linear.defect), fit.variances).force


def _of_laws(
    side: ForceSide, fit: Fitted, states: JointStates, joint: int
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Force of the laws at a joint, half the width of its 90 % interval, (S, K) each, and what they depend on."""
    model = side.stretches.data.recordings[0].model
    force = np.zeros(states.v.shape[:2])
    slopes, rows, follows, first = [], list[int](), list[str](), 0

    def of(law: LawTerm, other: int, values: np.ndarray) -> np.ndarray:
        at = states.of(int(model.jnt_dofadr[joint]), int(model.jnt_dofadr[other]))
        return (-states.turns(int(model.jnt_dofadr[joint])) if law.friction else 1.0) * law.force(at, values)

    for candidate, own in fit.point.named:
        law, values = candidate.effect.law, np.array(own)
        if law is not None and candidate.place.joints[0] == joint:
            other = candidate.place.joints[-1]
            force = force + of(law, other, values)
            follows += [name for name in law.variables if name not in follows]
            for i, parameter in enumerate(candidate.parameters):
                step = 1e-4 * abs(parameter.step) * np.eye(len(values))[i]
                slopes.append((of(law, other, values + step) - of(law, other, values - step)) / (2 * step[i]))
                rows.append(first + i)
        first += len(values)
    if not rows:
        return force, np.zeros_like(force), ()
    spread = covariance(side, fit)[np.ix_(rows, rows)]
    slope = np.stack(slopes, -1)
    return force, QUANTILE * np.sqrt(np.maximum(np.einsum("ski,ij,skj->sk", slope, spread, slope), 0.0)), tuple(follows)
