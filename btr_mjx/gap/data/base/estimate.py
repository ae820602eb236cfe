"""Fills in the states of a base that were not measured, with how well they are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from btr_mjx.errors import InputError
from btr_mjx.gap.data.base.motion import BaseMotion, Legs, MeasuredBase, Unit
from btr_mjx.gap.data.base.residuals import inertia_of, poses
from btr_mjx.gap.data.base.smoother import BaseMotions, smoothed_bases
from btr_mjx.gap.data.columns.model_columns import imu_columns
from btr_mjx.gap.data.recordings.noise import DIFFERENCE_ORDER, annihilator, estimate_noise
from btr_mjx.gap.data.recordings.recording import Recording, StateEstimate
from btr_mjx.models import part_names

_AGREES = 2.0
"""Largest distance of a pose from what the unit says, in units of the pose's noise."""
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


@dataclass(frozen=True, eq=False)
class _Source:
    """What was measured of a recording."""

    imu: _Imu
    unit: Unit
    legs: Legs


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
    for one in recordings:
        if not _can_touch(one.model, base := _hidden_base(one)):
            raise InputError(
                f"{one.name}: the pose of {one.model.body(base).name!r} was not measured, and the robot can touch "
                "nothing in the model that stands still, from which it could be estimated; record the pose, or give "
                "the model the ground on which the robot stood"
            )
    sources = [_source(one, _hidden_base(one)) for one in recordings]
    found = _smoothed(sources)
    mount, late = sources[0].imu.mount, found.late
    speed = float(np.median([motion.spread[3:6].max() for motion in found.motions]))
    turned = np.degrees(np.linalg.norm((found.mount * mount.inv()).as_rotvec()))
    notes.append(
        "the pose of the base was not measured: its motion is estimated from the IMU and from what touches the ground "
        f"(velocity to {speed:.1g} m/s); the IMU is turned by {turned:.2g} degrees from where the model has it"
        + (
            f", and logged {abs(late) * 1e3:.1f} ms {'later' if late > 0 else 'earlier'} than the encoders"
            if late
            else ""
        )
    )
    rows = zip(recordings, sources, found.motions, strict=True)
    return [_filled(*row, found.mount, found.late) for row in rows]


def sharpened_bases(recordings: Sequence[Recording], checkpoint: Callable[[], object]) -> list[Recording]:
    """States of bases that were measured, beside an inertial unit on them; see `loading.with_imu`."""
    model = recordings[0].model
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if len(free) != 1 or not _can_touch(model, int(model.jnt_bodyid[free[0]])):
        return list(recordings)
    base, names = int(model.jnt_bodyid[free[0]]), [f"sensor/{name}" for name in recordings[0].sensor]
    whole = all(np.isfinite(list(one.sensor.values())).all() for one in recordings if one.sensor)
    if not whole or any(one.estimate or not imu_columns(names, model, int(free[0])) for one in recordings):
        return list(recordings)
    sources = [_source(one, base) for one in recordings]
    found = _smoothed(sources, checkpoint)
    apart = [_disagreement(own, motion, found) for own, motion in zip(sources, found.motions, strict=True)]
    if np.median(apart) > _AGREES:
        return list(recordings)
    rows = zip(recordings, sources, found.motions, strict=True)
    return [_filled(*row, found.mount, found.late) for row in rows]


def _smoothed(sources: Sequence[_Source], checkpoint: Callable[[], object] = lambda: None) -> BaseMotions:
    rows = [own.unit for own in sources], [own.legs for own in sources]
    return smoothed_bases(*rows, sources[0].imu.mount, _SHORT, checkpoint)


def _pose_of(recording: Recording, base: int, sigma: np.ndarray) -> MeasuredBase:
    """The measured pose of a base, with the noise (2 nv,) of all states."""
    model = recording.model
    q, v = int(model.jnt_qposadr[model.body_jntadr[base]]), int(model.jnt_dofadr[model.body_jntadr[base]])
    noise = np.concatenate([sigma[v : v + 3], sigma[model.nv + v : model.nv + v + 3], sigma[v + 3 : v + 6]])
    noise[3:6] = np.where(recording.qvel_measured[v : v + 3], noise[3:6], np.inf)
    turn = Rotation.from_quat(recording.qpos[:, q + 3 : q + 7], scalar_first=True)
    return MeasuredBase(recording.qpos[:, q : q + 3], turn, recording.qvel[:, v : v + 3], noise)


def _disagreement(source: _Source, motion: BaseMotion, found: BaseMotions) -> float:
    """Root mean square of the distance from a measured pose in units of its noise, of the coordinate with the most."""
    unit = source.unit.earlier(found.late)
    inertia = inertia_of(unit, motion, found.mount)
    return float(np.sqrt((poses(source.legs, unit, motion, inertia).residual ** 2).mean(0)).max())


def _hidden_base(recording: Recording) -> int:
    """The body whose pose was not measured."""
    model = recording.model
    kinds = zip(model.jnt_bodyid, model.jnt_type, model.jnt_dofadr, strict=True)
    return next(int(b) for b, kind, dof in kinds if kind == mujoco.mjtJoint.mjJNT_FREE and not recording.seen[dof])


def _imu_of(recording: Recording, base: int) -> _Imu:
    """The sensors on a base."""
    model = recording.model
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


def _source(recording: Recording, base: int) -> _Source:
    """What was measured, in the frame of the accelerometer."""
    model, time, imu = recording.model, recording.time, _imu_of(recording, base)
    gyro = (imu.mount.inv() * imu.gyro_turn).apply(imu.gyro)
    noise = _white_noise(time, gyro), _white_noise(time, imu.accelerometer)
    encoders = estimate_noise(model, [(time, recording.qpos, recording.qvel, recording.qvel_measured)])
    sigma = np.concatenate([encoders.qpos, encoders.qvel])
    seen = recording.seen[int(model.jnt_dofadr[model.body_jntadr[base]])]
    pose = _pose_of(recording, base, sigma) if seen else None
    unit = Unit(time, gyro, imu.accelerometer, imu.orientation, noise, pose)
    return _Source(imu, unit, Legs(model, base, imu.place, recording.qpos, recording.qvel, sigma))


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


def _filled(recording: Recording, source: _Source, motion: BaseMotion, mount: Rotation, late: float) -> Recording:
    """A recording with the states of its base, and how well these are known."""
    imu, unit, legs = source.imu, source.unit.earlier(late), source.legs
    model, seen, measured = recording.model, recording.seen.copy(), recording.qvel_measured.copy()
    first = int(model.jnt_dofadr[model.body_jntadr[imu.base]])
    own = slice(first, first + 6)
    spin, qvel = mount.apply(unit.gyro - motion.biases[:3]), recording.qvel.copy()
    velocity = motion.velocity - motion.turn.apply(np.cross(spin, imu.place))
    qvel[:, own], seen[own], measured[own] = np.concatenate([velocity, spin], axis=1), True, True
    # Zeros of encoders displace feet for the whole recording, and all that stands on these.
    height = np.hypot(motion.spread[2], motion.gap.sigma)
    tilt = np.hypot(motion.spread[6:], motion.gap.sigma / legs.arm)
    # A unit whose direction is known to that much only mixes the axes of what changes.
    turned = float(np.linalg.norm(tilt) / np.sqrt(3))
    force = unit.accelerometer - unit.accelerometer.mean(0)
    rate, push = (turned * float(np.median(np.linalg.norm(v, axis=1))) for v in (spin, force))
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
