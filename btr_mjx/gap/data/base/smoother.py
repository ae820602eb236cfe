"""State of a base from an inertial unit and from feet that touch the ground, without motion capture.

All recordings are one least-squares problem, solved by Gauss-Newton steps. Unknown at every sample are place and
velocity of the unit and the orientation of the base, unknown for a recording the biases of the unit, unknown for all
recordings how it is turned on the base and how late it is logged. Gyro and accelerometer tie each sample to the next; a
point that touches has no distance from the ground and no velocity. Whether it touches is a probability, computed from
its own residuals at every step (expectation maximisation), as are the scatter of these residuals and the time over
which they stay the same: a foot that creeps does so for a whole stance. The robot's dynamics are not used: nothing that
they lack enters.

After Bloesch et al. 2012, "State estimation for legged robots": feet and an inertial unit in one filter.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from btr_mjx.gap.data.base.block_system import BlockSystem, eliminated
from btr_mjx.gap.data.base.motion import COMMON, BaseMotion, Legs, Unit, first_estimate
from btr_mjx.gap.data.base.residuals import inertia_of, poses, propagation, tilts, touches
from btr_mjx.gap.data.base.touching import Touching

MOUNT, LATE, BIASES = np.radians(2.0), 0.01, np.repeat([0.02, 0.1], 3)
"""Standard deviations before the recordings are seen: turn of the unit [rad]; time by which it is logged later than the
encoders [s]; biases of gyro [rad/s] and accelerometer [m/s^2]."""
_COMMON = 4
"""Unknowns that all recordings share: how the unit is turned, how late it is."""
_CREEP, _HELD = 3e-3, 1e-6
"""Delays below this are not told from creep, and taken for none [s]: feet that creep under load move as if the unit was
1 to 2 ms late or early. Larger ones are whole samples, as rows hold what was read last. Standard deviation of a delay
that is taken for known [s]."""
_FIXED = np.repeat([1e4, 0.0, 1e2], 3)
"""Weights that hold the first sample: nothing measures where it is, and an angle about the vertical."""
_STEPS, _CONVERGED = 20, 2e-3
"""Largest number of steps, and change of all velocities [m/s] below which there are no more."""
_SEEN = 3
"""First steps in which points that may touch are looked for; later these points move with the base."""
_PICKED = 40
"""Samples at which the spread is computed; the mean of variances is used."""


@dataclass(frozen=True, eq=False)
class BaseMotions:
    """Motions of a base, and what recordings share: the unit's rotation to the base, and how late it is logged [s]."""

    motions: tuple[BaseMotion, ...]
    mount: Rotation
    late: float


def smoothed_bases(
    units: Sequence[Unit],
    legs: Sequence[Legs],
    mount: Rotation,
    lag: float,
    checkpoint: Callable[[], object] = lambda: None,
) -> BaseMotions:
    """Estimate the motion of the base in recordings of one robot.

    Args:
      units: of each recording.
      legs: of each recording.
      mount: rotation from the unit's frame to the base's, as the model has it.
      lag: time over which `BaseMotion.within` is a change [s].
      checkpoint: called often; it may raise to stop.

    Returns:
      The motions, with their spread, and what recordings share. Without a pose the delay is none or whole samples.

    Raises:
      LinAlgError: measurements of the unit contradict each other.
    """
    motions = tuple(first_estimate(*pair, mount) for pair in zip(units, legs, strict=True))
    now, systems, covariance = _settled(units, legs, BaseMotions(motions, mount, 0.0), mount, LATE, checkpoint)
    if any(unit.pose is None for unit in units):
        interval = float(np.median(np.diff(units[0].time)))
        late = 0.0 if abs(now.late) < _CREEP else round(now.late / interval) * interval
        now, systems, covariance = _settled(units, legs, replace(now, late=late), mount, _HELD, checkpoint)
        now = replace(now, late=late)
    lags = [max(1, round(lag / float(np.median(np.diff(unit.time))))) for unit in units]
    rows = zip(now.motions, systems, lags, strict=True)
    return replace(now, motions=tuple(_with_spread(*row, covariance) for row in rows))


def _settled(
    units: Sequence[Unit],
    legs: Sequence[Legs],
    now: BaseMotions,
    mount: Rotation,
    late: float,
    checkpoint: Callable[[], object],
) -> tuple[BaseMotions, list[BlockSystem], np.ndarray]:
    """Gauss-Newton steps from an estimate until it stays where it is.

    Args:
      units: of each recording.
      legs: of each recording.
      now: the estimate.
      mount: as the model has it.
      late: standard deviation of the delay around that of the estimate, before the recordings are seen [s].
      checkpoint: called for each recording in each step.

    Returns:
      The estimate, the last systems, and the covariance (4, 4) of what recordings share.
    """
    information, believed = np.diag(1 / np.array([MOUNT, MOUNT, MOUNT, late]) ** 2), now.late
    for step in range(_STEPS):
        if step < _SEEN:
            points = [own.points(motion.place, motion.turn) for own, motion in zip(legs, now.motions, strict=True)]
        systems, after = [], []
        moved = [unit.earlier(now.late) for unit in units]
        for row in zip(moved, legs, points, now.motions, strict=True):
            checkpoint()
            system, changed = _system(*row, now.mount)
            systems.append(system)
            after.append(changed)
        pull = information @ [*(now.mount * mount.inv()).as_rotvec(), now.late - believed]
        parts = [_without_biases(system) for system in systems]
        covariance = np.linalg.inv(information + sum(part[0] for part in parts))
        common = -covariance @ (pull + sum(part[1] for part in parts))
        borders = [_border(system, common) for system in systems]
        changes = [system.step(border) for system, border in zip(systems, borders, strict=True)]
        if not all(np.isfinite(change).all() for change in changes):
            raise np.linalg.LinAlgError("the unit's measurements contradict each other")
        now = _moved(replace(now, motions=tuple(after)), changes, borders)
        if max(float(np.abs(change[:, 3:6]).max()) for change in changes) < _CONVERGED:
            break
    return now, systems, covariance


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
    known = np.concatenate([np.zeros(_COMMON), 1 / BIASES**2])
    pull = known * np.concatenate([np.zeros(_COMMON), motion.biases])
    system = eliminated(len(unit.time), rows, _FIXED, np.diag(known), pull)
    return system, replace(motion, slip=slip, gap=gap, tilt=tilt, carrying=carrying)


def _without_biases(system: BlockSystem) -> tuple[np.ndarray, np.ndarray]:
    """Information (4, 4) and gradient (4,) of what recordings share, after the biases were eliminated."""
    shared, own = slice(0, _COMMON), slice(_COMMON, COMMON)
    across, rest = system.information[shared, own], system.information[own, own]
    information = system.information[shared, shared] - across @ np.linalg.solve(rest, across.T)
    return information, system.pull[shared] - across @ np.linalg.solve(rest, system.pull[own])


def _border(system: BlockSystem, common: np.ndarray) -> np.ndarray:
    """(10,) change of what recordings share, and of the biases that goes with it."""
    shared, own = slice(0, _COMMON), slice(_COMMON, COMMON)
    pull = system.pull[own] + system.information[own, shared] @ common
    return np.concatenate([common, -np.linalg.solve(system.information[own, own], pull)])


def _moved(now: BaseMotions, changes: Sequence[np.ndarray], borders: Sequence[np.ndarray]) -> BaseMotions:
    """After changes (K, 9) of the states of each recording, and (10,) of what lies beside them."""
    motions = tuple(
        replace(
            motion,
            place=motion.place + change[:, :3],
            velocity=motion.velocity + change[:, 3:6],
            turn=motion.turn * Rotation.from_rotvec(change[:, 6:]),
            biases=motion.biases + border[_COMMON:],
        )
        for motion, change, border in zip(now.motions, changes, borders, strict=True)
    )
    common = borders[0][:_COMMON]
    return BaseMotions(motions, Rotation.from_rotvec(common[:3]) * now.mount, now.late + float(common[3]))


def _with_spread(motion: BaseMotion, system: BlockSystem, lag: int, common: np.ndarray) -> BaseMotion:
    rest = np.linalg.inv(system.information[_COMMON:, _COMMON:])
    across = -rest @ system.information[_COMMON:, :_COMMON]
    both = across @ common
    border = np.block([[common, both.T], [both, rest + both @ across.T]])
    count = len(motion.place)
    picked = np.unique(np.linspace(0.1 * count, 0.9 * count - lag, _PICKED).astype(int))
    at, moved = (np.sqrt(np.maximum(v, 0).mean(0)) for v in system.covariances(picked, lag, border))
    return replace(motion, spread=at, within=moved / np.sqrt(2))
