"""Shapes of a force that named effects leave: simple functions of the state that no effect of the library is.

A force phi(q, v, tau, t) at one joint moves the state by G_k phi_k over an interval, so that its column needs no
simulation. What one of these explains beside all that was named says that something else is missing, and what
it follows.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.gap.forces.evidence import least_squares
from btr_mjx.gap.forces.filtering import filtered
from btr_mjx.gap.forces.missing_force import MissingForce
from btr_mjx.gap.forces.points import Fitted, ForceSide
from btr_mjx.gap.forces.scan import price
from btr_mjx.models import part_names

_Shape = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]

SHAPES: Mapping[str, _Shape] = {
    "the absolute value of its position": lambda q, v, tau, t: np.abs(q),
    "the square of its position": lambda q, v, tau, t: q**2,
    "the cube of its position": lambda q, v, tau, t: q**3,
    "its speed times its position": lambda q, v, tau, t: q * v,
    "the square of its speed": lambda q, v, tau, t: v * np.abs(v),
    "its load, more and more with time (a drift)": lambda q, v, tau, t: tau * t,
    "time (a drift)": lambda q, v, tau, t: t,
    "the square of its load": lambda q, v, tau, t: tau * np.abs(tau),
}
"""Functions of position and speed in units of their spread, of the actuators' force, and of time in the recording."""

_RIPPLES = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
"""Ripples per radian or metre that are tried, each with both phases, where the motion shows a whole one."""


@dataclass(frozen=True)
class ShapeGain:
    """What a shape explains beside named effects.

    Attributes:
      dof: where the force acts.
      follows: what it follows, in words.
      score: fall of -2 ln p less the price of the shape.
    """

    dof: int
    follows: str
    score: float


def best_shape(side: ForceSide, fit: Fitted, missing: MissingForce) -> ShapeGain:
    """The shape that explains most beside a fit.

    Args:
      side: the recordings to fit.
      fit: with all that was named, at the stretches of the side.
      missing: velocities and actuator forces along the same stretches.
    """
    linear, p = fit.linear, fit.point.numbers
    model = side.stretches.data.recordings[0].model
    nv = missing.velocity.shape[-1]
    columns, what = [], []
    begin = np.array([r.time[0] for r in side.stretches.data.recordings])[side.stretches.recording]
    time = side.stretches.time[:, :-1] - begin[:, None]
    for dof in range(nv):
        joint = int(model.dof_jntid[dof])
        if int(model.jnt_type[joint]) < int(mujoco.mjtJoint.mjJNT_SLIDE):
            continue
        position = side.stretches.qpos[:, :-1, model.jnt_qposadr[joint]]
        centred = position - position.mean()
        q, v = centred / max(float(centred.std()), 1e-12), missing.velocity[..., dof]
        v = v / max(float(np.sqrt((v**2).mean())), 1e-12)
        tau = missing.actuator[..., dof] / max(float(np.abs(missing.actuator[..., dof]).mean()), 1e-12)
        repeated = [n for n in _RIPPLES if n * np.ptp(position) > 2 * np.pi]
        waves = [np.stack([np.sin(n * position), np.cos(n * position)], -1) for n in repeated]
        shapes = [(name, shape(q, v, tau, time)[..., None]) for name, shape in SHAPES.items()]
        for name, values in [*shapes, *(("a ripple over its position", wave) for wave in waves)]:
            columns.append(linear.force[..., dof, None] * values[:, :, None, :])
            what.append((dof, name, values.shape[-1]))
    if not columns:
        return ShapeGain(0, "", -np.inf)
    every = np.concatenate([fit.columns, *columns], -1)
    gram = filtered(linear, every, fit.variances).gram.sum(0)
    size, n = every.shape[-1], len(side.library.calibrated)
    prior = side.library.calibration
    prior = replace(prior, design=np.eye(size)[:, p : p + n], at=fit.point.calibration)
    own = np.eye(size)[:, :p]
    before = least_squares(gram, own, prior).loss
    count, first, best = fit.whitened.count * len(side.stretches), p + n, ShapeGain(0, "", -np.inf)
    for dof, name, width in what:
        free = np.concatenate([own, np.eye(size)[:, first : first + width]], 1)
        first += width
        score = before - least_squares(gram, free, prior).loss - price(width, count, len(what))
        if score > best.score:
            best = ShapeGain(dof, name, score)
    return best


def shape_sentence(model: mujoco.MjModel, shape: ShapeGain) -> str:
    """A shape in words."""
    joint = part_names(model, "joint")[model.dof_jntid[shape.dof]]
    return f"joint {joint}: a force there follows {shape.follows}, as no effect that was tried does"
