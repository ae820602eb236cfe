"""What an IMU should have measured in short stretches of a recording, and what it did.

Over a stretch, the integral of a gyro is the rotation of its site. The mean of an accelerometer is the site's
acceleration without gravity, where the mean is weighted by a triangle: the second difference of positions is such a
mean of the acceleration.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Recording, sensor_body
from btr_mjx.gap.preflight.velocities import rotations
from btr_mjx.models import part_names

_SECONDS, _INTERVALS = 0.1, 4
"""Shortest stretch, in seconds and in sampling intervals."""
_QUIET = 0.2
"""Rotation in a stretch below which gravity keeps its direction [rad]."""


@dataclass(frozen=True, eq=False)
class ImuVectors:
    """Vectors (N, 3) in stretches of a recording, in the axes of a site; measured ones are NaN where not logged.

    Attributes:
      turned: rotation of the site [rad]; None where its orientation was not measured.
      felt: acceleration of the site without gravity [m/s^2]; in the model's starting pose where `turned` is None.
      gyro: integral of the gyro.
      accelerometer: weighted mean of the accelerometer.
    """

    turned: np.ndarray | None
    felt: np.ndarray
    gyro: np.ndarray
    accelerometer: np.ndarray


def imu_vectors(recording: Recording, site: int, gyro: str, accelerometer: str, most: int) -> ImuVectors:
    """Vectors of at most `most` stretches that are spread evenly; those without a measurement are left out.

    Args:
      recording: the recording.
      site: id of the site of both sensors.
      gyro: name of the gyro, "" if it was not logged. Where the orientation was not measured, only stretches count in
        which it hardly turns.
      accelerometer: name of the accelerometer, "" if it was not logged.
      most: number of stretches.
    """
    model, time = recording.model, recording.time
    half = max(_INTERVALS, round(_SECONDS / float(np.median(np.diff(time))))) // 2
    first = np.arange(0, len(time) - 2 * half, 2 * half)
    first = first[np.unique(np.linspace(0, len(first) - 1, min(most, len(first))).astype(int))]
    rows = first[:, None] + np.arange(2 * half + 1)
    t = time[rows, None]
    rising, falling = (t - t[:, :1]) / (t[:, half, None] - t[:, :1]), (t[:, -1:] - t) / (t[:, -1:] - t[:, half, None])
    weight = np.minimum(rising, falling)
    nothing = np.full((*rows.shape, 3), np.nan)
    turning, pulling = (
        nothing if values is None else values[rows]
        for values in (recording.measured_by(gyro), recording.measured_by(accelerometer))
    )
    integral = np.trapezoid(turning, t, axis=1)
    mean = np.trapezoid(weight * pulling, t, axis=1) / np.trapezoid(weight, t, axis=1)
    poses = _poses(recording, site, rows[:, [0, half, -1]])
    if poses is None:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        turned, whole = None, np.linalg.norm(integral, axis=1) < _QUIET
        felt = np.tile(data.site_xmat[site].reshape(3, 3).T @ -model.opt.gravity, (len(rows), 1))
    else:
        from scipy.spatial.transform import Rotation  # slow to load

        turns, places = poses
        whole = np.isfinite(turns).all(axis=(1, 2, 3))
        turns = np.where(whole[:, None, None, None], turns, np.eye(3))
        turned = (Rotation.from_matrix(turns[:, 0]).inv() * Rotation.from_matrix(turns[:, 2])).as_rotvec()
        slope = np.diff(places, axis=1) / np.diff(t[:, [0, half, -1]], axis=1)
        moved = 2 * (slope[:, 1] - slope[:, 0]) / (t[:, -1] - t[:, 0])
        felt = np.einsum("nji,nj->ni", turns[:, 1], moved - model.opt.gravity)
    for name, values in ((gyro, integral), (accelerometer, mean)):
        whole = whole & (np.isfinite(values).all(axis=1) if name else True)
    return ImuVectors(None if turned is None else turned[whole], felt[whole], integral[whole], mean[whole])


def _poses(recording: Recording, site: int, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Orientations (N, 3, 3, 3) and places (N, 3, 3) of a site at rows (N, 3); None where they were not measured.

    An orientation that only a sensor of the same body tells has places that do not move, and NaN for what is no
    quaternion.
    """
    model = recording.model
    data = mujoco.MjData(model)
    if _all_measured(recording, int(model.site_bodyid[site])):
        turns, places = np.empty((*rows.shape, 3, 3)), np.empty((*rows.shape, 3))
        for at, row in np.ndenumerate(rows):
            data.qpos[:] = recording.qpos[row]
            mujoco.mj_kinematics(model, data)
            turns[at], places[at] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
        return turns, places
    mujoco.mj_forward(model, data)
    for sensor, name in enumerate(part_names(model, "sensor")):
        own = model.sensor_type[sensor] == mujoco.mjtSensor.mjSENS_FRAMEQUAT and model.sensor_refid[sensor] < 0
        if not own or model.body_weldid[sensor_body(model, sensor)] != model.body_weldid[model.site_bodyid[site]]:
            continue
        if (quaternions := recording.measured_by(name)) is None:
            continue
        values = quaternions[rows].reshape(-1, 4)
        bad = ~(np.abs(np.linalg.norm(values, axis=1) - 1) < 0.05)
        address = model.sensor_adr[sensor]
        to_site = rotations(data.sensordata[address : address + 4][None])[0].T @ data.site_xmat[site].reshape(3, 3)
        turns = rotations(np.where(bad[:, None], (1.0, 0.0, 0.0, 0.0), values)) @ to_site
        turns[bad] = np.nan
        return turns.reshape(*rows.shape, 3, 3), np.zeros((*rows.shape, 3))
    return None


def _all_measured(recording: Recording, body: int) -> bool:
    """Whether all joints between a body and the world were measured."""
    model, measured = recording.model, recording.sensed
    while body > 0:
        dofs = slice(model.body_dofadr[body], model.body_dofadr[body] + model.body_dofnum[body])
        if model.body_dofnum[body] and not measured[dofs].all():
            return False
        body = int(model.body_parentid[body])
    return True
