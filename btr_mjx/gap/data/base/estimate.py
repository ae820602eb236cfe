"""Fills in the states of a base that were not measured, with how well they are known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from btr_mjx.errors import InputError
from btr_mjx.gap.data.base.motion import Legs, Motion, Unit
from btr_mjx.gap.data.base.smoother import smoothed
from btr_mjx.gap.data.recordings.noise import DIFFERENCE_ORDER, annihilator, estimate_noise
from btr_mjx.gap.data.recordings.recording import Recording, StateEstimate
from btr_mjx.models import part_names

_SHORT = 0.02
"""Time within which errors of a state count as noise; those that last longer stay for a whole window [s]."""
_GYRO, _ACCELEROMETER, _ORIENTATION = (
    int(kind)
    for kind in (
        mujoco.mjtSensor.mjSENS_GYRO,
        mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        mujoco.mjtSensor.mjSENS_FRAMEQUAT,
    )
)


@dataclass(frozen=True, eq=False)
class _Imu:
    """Sensors of an inertial unit: measurements (K, dim), and rotations from their frames to that of the base.

    `place` (3,) is that of the accelerometer in the frame of the base [m].
    """

    base: int
    place: np.ndarray
    gyro: np.ndarray
    gyro_turn: Rotation
    accelerometer: np.ndarray
    mount: Rotation
    orientation: Rotation | None


def estimate_bases(recordings: Sequence[Recording], notes: list[str]) -> list[Recording]:
    """Estimate the states of a base whose pose was not measured, in all recordings of one robot.

    Args:
      recordings: with an inertial unit, and without a pose of its base.
      notes: what was found is appended.

    Returns:
      The recordings, with estimated states of the base, which count as measured, and `Recording.estimate`.

    Raises:
      InputError: the model has nothing that the robot can touch.
    """
    units = [_imu_of(one) for one in recordings]
    pairs = [_unit_and_legs(one, own) for one, own in zip(recordings, units, strict=True)]
    mount = units[0].mount
    motions, found, _ = smoothed([unit for unit, _ in pairs], [legs for _, legs in pairs], mount, _SHORT)
    speed = float(np.median([motion.spread[3:6].max() for motion in motions]))
    turned = np.degrees(np.linalg.norm((found * mount.inv()).as_rotvec()))
    notes.append(
        "the pose of the base was not measured: its motion is estimated from the IMU and from what touches the ground "
        f"(velocity to {speed:.1g} m/s); the IMU is turned by {turned:.2g} degrees from where the model has it"
    )
    rows = zip(recordings, units, pairs, motions, strict=True)
    return [_filled(one, own, *pair, motion, found) for one, own, pair, motion in rows]


def _imu_of(recording: Recording) -> _Imu:
    """The sensors on the base whose pose was not measured."""
    model = recording.model
    base = next(
        int(body)
        for body, kind, dof in zip(model.jnt_bodyid, model.jnt_type, model.jnt_dofadr, strict=True)
        if kind == mujoco.mjtJoint.mjJNT_FREE and not recording.seen[dof]
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    frame = Rotation.from_matrix(data.xmat[base].reshape(3, 3)).inv()
    found: dict[int, tuple[np.ndarray, np.ndarray, Rotation]] = {}
    for i, name in enumerate(part_names(model, "sensor")):
        kind, own, values = int(model.sensor_type[i]), int(model.sensor_objid[i]), recording.measured_by(name)
        if kind not in (_GYRO, _ACCELEROMETER, _ORIENTATION) or kind in found or values is None:
            continue
        site = model.sensor_objtype[i] == mujoco.mjtObj.mjOBJ_SITE
        place, turn = (data.site_xpos[own], data.site_xmat[own]) if site else (data.xpos[own], data.xmat[own])
        if model.body_weldid[model.site_bodyid[own] if site else own] == base:
            turned = frame * Rotation.from_matrix(turn.reshape(3, 3))
            found[kind] = values, frame.apply(place - data.xpos[base]), turned
    (gyro, _, gyro_turn), (accelerometer, place, mount) = found[_GYRO], found[_ACCELEROMETER]
    orientation = None
    if _ORIENTATION in found:
        quat, _, turned = found[_ORIENTATION]
        orientation = Rotation.from_quat(quat, scalar_first=True) * (mount.inv() * turned).inv()
    return _Imu(base, place, gyro, gyro_turn, accelerometer, mount, orientation)


def _unit_and_legs(recording: Recording, imu: _Imu) -> tuple[Unit, Legs]:
    """What was measured, in the frame of the accelerometer."""
    model, time = recording.model, recording.time
    if not _can_touch(model, imu.base):
        raise InputError(
            f"{recording.name}: the pose of {model.body(imu.base).name!r} was not measured, and the robot can touch "
            "nothing in the model that stands still, from which it could be estimated; record the pose, or give the "
            "model the ground on which the robot stood"
        )
    gyro = (imu.mount.inv() * imu.gyro_turn).apply(imu.gyro)
    noise = _white_noise(time, gyro), _white_noise(time, imu.accelerometer)
    unit = Unit(time, gyro, imu.accelerometer, imu.orientation, noise)
    encoders = estimate_noise(model, [(time, recording.qpos, recording.qvel, recording.qvel_measured)])
    sigma = np.concatenate([encoders.qpos, encoders.qvel])
    return unit, Legs(model, imu.base, imu.place, recording.qpos, recording.qvel, sigma)


def _can_touch(model: mujoco.MjModel, base: int) -> bool:
    """Whether a geom of the robot on a base may collide with one that does not move."""
    bodies = model.body_weldid[model.geom_bodyid]
    fixed, own = bodies == 0, model.body_rootid[model.geom_bodyid] == model.body_rootid[base]
    kinds, others = model.geom_contype, model.geom_conaffinity
    meets = (kinds[own][:, None] & others[fixed]) | (others[own][:, None] & kinds[fixed])
    return bool(meets.any())


def _white_noise(time: np.ndarray, values: np.ndarray) -> float:
    """Standard deviation of the white noise of (K, 3) values: what no polynomial over a few samples explains."""
    index = np.arange(len(time) - DIFFERENCE_ORDER)[:, None] + np.arange(DIFFERENCE_ORDER + 1)
    left = np.einsum("ni,nid->nd", annihilator(time[index]), values[index])
    return max(float(np.median(np.abs(left))) / 0.6745, 1e-6)


def _filled(recording: Recording, imu: _Imu, unit: Unit, legs: Legs, motion: Motion, mount: Rotation) -> Recording:
    """A recording with the states of its base, and how well these are known."""
    model, seen, measured = recording.model, recording.seen.copy(), recording.qvel_measured.copy()
    first = int(model.jnt_dofadr[model.body_jntadr[imu.base]])
    own = slice(first, first + 6)
    spin, qvel = mount.apply(unit.gyro - motion.biases[:3]), recording.qvel.copy()
    velocity = motion.velocity - motion.turn.apply(np.cross(spin, imu.place))
    qvel[:, own], seen[own], measured[own] = np.concatenate([velocity, spin], axis=1), True, True
    # Zeros of encoders displace feet for the whole recording, and all that stands on these.
    height, tilt = (
        np.hypot(motion.spread[2], motion.gap.sigma),
        np.hypot(motion.spread[6:], motion.gap.sigma / legs.arm),
    )
    # A unit whose mount is known to that much only mixes the axes of what changes.
    turned = float(np.linalg.norm(tilt) / np.sqrt(3))
    force = unit.accelerometer - unit.accelerometer.mean(0)
    rate, push = (turned * float(np.median(np.linalg.norm(values, axis=1))) for values in (spin, force))
    within = np.hypot(motion.within, np.repeat([0.0, push * _SHORT, rate * _SHORT], 3))
    spins = np.full(3, np.hypot(unit.noise[0], rate))
    sigma, spread = np.full((2, 2 * model.nv), np.nan)
    both = np.r_[own, first + model.nv : first + model.nv + 6]
    sigma[both] = [*within[:3], *within[6:], *within[3:6], *spins]
    spread[both] = [height, height, height, *tilt, *motion.spread[3:6], *spins]
    return replace(
        recording,
        qpos=legs.posed(motion.place, motion.turn),
        qvel=qvel,
        qpos_measured=seen,
        qvel_measured=measured,
        estimate=StateEstimate(sigma, spread),
    )
