"""State of a base from an inertial unit and from feet that touch the ground, without motion capture.

All recordings are one least-squares problem, solved by Gauss-Newton steps. Unknown at every sample are place and
velocity of the unit and the orientation of the base, unknown for a recording the biases of the unit, unknown for all
recordings how it is turned on the base. Gyro and accelerometer tie each sample to the next; a point that touches has no
distance from the ground and no velocity. Whether it touches is a probability, computed from its own residuals at every
step (expectation maximisation), as are the scatter of these residuals and the time over which they stay the same: a
foot that creeps does so for a whole stance. The robot's dynamics are not used: nothing that they lack enters.

After Bloesch et al. 2012, "State estimation for legged robots": feet and an inertial unit in one filter.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from btr_mjx.gap.data.base.block_system import BlockSystem, eliminated
from btr_mjx.gap.data.base.motion import BaseMotion, Legs, Unit, first_estimate
from btr_mjx.gap.data.base.residuals import inertia_of, poses, propagation, tilts, touches
from btr_mjx.gap.data.base.touching import Touching

MOUNT, BIASES = np.radians(2.0), np.repeat([0.02, 0.1], 3)
"""Standard deviations before the recordings are seen: turn of the unit [rad]; biases of gyro [rad/s] and accelerometer
[m/s^2]."""
_FIXED = np.repeat([1e4, 0.0, 1e2], 3)
"""Weights that hold the first sample: nothing measures where it is, and an angle about the vertical."""
_STEPS, _CONVERGED = 20, 2e-3
"""Largest number of steps, and change of all velocities [m/s] below which there are no more."""
_SEEN = 3
"""First steps in which points that may touch are looked for; later these points move with the base."""
_PICKED = 40
"""Samples at which the spread is computed; the mean of variances is used."""


def smoothed_bases(
    units: Sequence[Unit], legs: Sequence[Legs], mount: Rotation, lag: float
) -> tuple[list[BaseMotion], Rotation, np.ndarray]:
    """Estimate the motion of the base in recordings of one robot.

    Args:
      units: of each recording.
      legs: of each recording.
      mount: rotation from the unit's frame to the base's, as the model has it.
      lag: time over which `BaseMotion.within` is a change [s].

    Returns:
      The motion of each recording, the rotation that was found, and (3,) its standard deviations about the axes of the
      base [rad].

    Raises:
      LinAlgError: measurements of the unit contradict each other.
    """
    motions, found = [first_estimate(*pair, mount) for pair in zip(units, legs, strict=True)], mount
    for step in range(_STEPS):
        if step < _SEEN:
            points = [own.points(motion.place, motion.turn) for own, motion in zip(legs, motions, strict=True)]
        systems, after = [], []
        for row in zip(units, legs, points, motions, strict=True):
            system, changed = _system(*row, found)
            systems.append(system)
            after.append(changed)
        information = np.eye(3) / MOUNT**2
        pull = information @ (found * mount.inv()).as_rotvec()
        parts = [_without_biases(system) for system in systems]
        covariance = np.linalg.inv(information + sum(part[0] for part in parts))
        turned = -covariance @ (pull + sum(part[1] for part in parts))
        steps = [_border(system, turned) for system in systems]
        changes = [system.step(border) for system, border in zip(systems, steps, strict=True)]
        last = max(float(np.abs(change[:, 3:6]).max()) for change in changes) < _CONVERGED or step == _STEPS - 1
        if not all(np.isfinite(change).all() for change in changes):
            raise np.linalg.LinAlgError("the unit's measurements contradict each other")
        motions = [_moved(*row) for row in zip(after, changes, steps, strict=True)]
        found = Rotation.from_rotvec(turned) * found
        if last:
            break
    lags = [max(1, round(lag / float(np.median(np.diff(unit.time))))) for unit in units]
    rows = zip(motions, systems, lags, strict=True)
    return [_with_spread(*row, covariance) for row in rows], found, np.sqrt(np.diag(covariance))


def _system(
    unit: Unit, legs: Legs, points: Touching, motion: BaseMotion, mount: Rotation
) -> tuple[BlockSystem, BaseMotion]:
    """Normal equations of a recording, and its motion with the scatter of its residuals."""
    inertia = inertia_of(unit, motion, mount)
    gravity = legs.model.opt.gravity
    contact, slip, gap, carrying = touches(points, unit, motion, inertia, gravity)
    rows, tilt = [propagation(unit, motion, inertia, gravity), contact], motion.tilt
    if unit.orientation is not None:
        reported, tilt = tilts(unit, motion, mount)
        rows.append(reported)
    if unit.pose is not None:
        rows.append(poses(legs, unit, motion, inertia))
    known = np.concatenate([np.zeros(3), 1 / BIASES**2])
    pull = known * np.concatenate([np.zeros(3), motion.biases])
    system = eliminated(len(unit.time), rows, _FIXED, np.diag(known), pull)
    return system, replace(motion, slip=slip, gap=gap, tilt=tilt, carrying=carrying)


def _without_biases(system: BlockSystem) -> tuple[np.ndarray, np.ndarray]:
    """Information (3, 3) and gradient (3,) of the mount after the biases were eliminated."""
    own, across, rest = system.information[:3, :3], system.information[:3, 3:], system.information[3:, 3:]
    return own - across @ np.linalg.solve(rest, across.T), system.pull[:3] - across @ np.linalg.solve(
        rest, system.pull[3:]
    )


def _border(system: BlockSystem, turned: np.ndarray) -> np.ndarray:
    """(9,) change of the mount and of the biases that goes with it."""
    pull = system.pull[3:] + system.information[3:, :3] @ turned
    return np.concatenate([turned, -np.linalg.solve(system.information[3:, 3:], pull)])


def _moved(motion: BaseMotion, change: np.ndarray, border: np.ndarray) -> BaseMotion:
    return replace(
        motion,
        place=motion.place + change[:, :3],
        velocity=motion.velocity + change[:, 3:6],
        turn=motion.turn * Rotation.from_rotvec(change[:, 6:]),
        biases=motion.biases + border[3:],
    )


def _with_spread(motion: BaseMotion, system: BlockSystem, lag: int, mount: np.ndarray) -> BaseMotion:
    rest = np.linalg.inv(system.information[3:, 3:])
    across = -rest @ system.information[3:, :3]
    both = across @ mount
    border = np.block([[mount, both.T], [both, rest + both @ across.T]])
    count = len(motion.place)
    picked = np.unique(np.linspace(0.1 * count, 0.9 * count - lag, _PICKED).astype(int))
    at, moved = (np.sqrt(np.maximum(v, 0).mean(0)) for v in system.covariances(picked, lag, border))
    return replace(motion, spread=at, within=moved / np.sqrt(2))
