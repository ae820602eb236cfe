"""What every drive has, at all joints at once: dry and viscous friction, rotor inertia, offsets, and servos' stiffness.

Each alone may explain little where all are missing: a model without rotors moves too much, and so everything that
lessens forces comes first. Inverse dynamics of smoothed states gives the numbers to start from.
"""

from dataclasses import replace

import mujoco
import numpy as np

from btr_mjx.gap.effects import Candidate, Place, joint_of
from btr_mjx.gap.forces.missing_force import drives, missing_force
from btr_mjx.gap.forces.points import Fitted, ForceSide, Point
from btr_mjx.gap.forces.unknowns import DRIVE

_STIFFNESS = "servo_stiffness"
"""Effect of servos whose stiffness is not the believed one."""

_SOFT = 0.01
"""Part of the believed stiffness at which no servo is at its force limit, so that forces are linear in it."""


def drive_points(side: ForceSide, fit: Fitted) -> list[Point]:
    """Points at which all drives have what models leave out; with the believed stiffness of servos, and with their own.

    A stiffness far from the believed one is out of reach of a scan, and so it is tried alone, too.

    Args:
      side: the recordings to fit.
      fit: what was named before.

    Returns:
      Nothing where a part of a drive is named already.
    """
    taken = {candidate.effect.name for candidate, _ in fit.point.named}
    widest = _widest(side)
    if taken & {*DRIVE, _STIFFNESS} or not widest.keys() & set(DRIVE):
        return []
    # Calibration at its bounds stands for what is missing: it starts anew.
    point = replace(fit.point, calibration=np.zeros_like(fit.point.calibration))
    # Smoothed states know of jitter and of what sensors see; differences of positions do not.
    stretches = fit.stretches
    found = drives(missing_force(stretches, point.hypothesis(side.library)))
    out = [_named(side, point, widest, dict(zip(DRIVE, found[:4], strict=True)))]
    if _STIFFNESS in widest:
        servos = widest[_STIFFNESS]
        softer, soft = (
            missing_force(stretches, point.hypothesis(side.library).with_effect(servos, values))
            for values in np.multiply.outer([_SOFT - 1, 2 * _SOFT - 1], np.ones(len(servos.parameters)))
        )
        found = drives(softer, soft.actuator - softer.actuator)
        rows = dict(zip((*DRIVE, _STIFFNESS), (*found[:4], _SOFT * (1 + found[4]) - 1), strict=True))
        out += [_named(side, point, widest, own) for own in (rows, {_STIFFNESS: rows[_STIFFNESS]})]
    return out


def _widest(side: ForceSide) -> dict[str, Candidate]:
    """The candidate of each effect of a drive that has most numbers."""
    out: dict[str, Candidate] = {}
    for entry in side.library.entries:
        name, own = entry.candidate.effect.name, entry.candidate
        if name in (*DRIVE, _STIFFNESS) and (name not in out or len(own.parameters) > len(out[name].parameters)):
            out[name] = own
    return out


def _named(side: ForceSide, point: Point, widest: dict[str, Candidate], rows: dict[str, np.ndarray]) -> Point:
    """A point with effects of a drive, with numbers (nv,) of each."""
    model, named = side.stretches.data.recordings[0].model, list(point.named)
    for name, row in rows.items():
        if name in widest:
            candidate = widest[name]
            values = [float(row[_dofs(model, place)].mean()) for place in candidate.place.parts or (candidate.place,)]
            bounded = [float(np.clip(v, p.low, p.high)) for v, p in zip(values, candidate.parameters, strict=True)]
            named.append((candidate, tuple(bounded)))
    return replace(point, named=tuple(named))


def _dofs(model: mujoco.MjModel, place: Place) -> np.ndarray:
    """Degrees of freedom of the joints of a place, or of those that its actuators drive."""
    driven = [joint for a in place.actuators if (joint := joint_of(model, a)) is not None]
    return model.jnt_dofadr[[*place.joints] or driven].astype(int)
