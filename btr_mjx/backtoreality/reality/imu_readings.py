"""What the IMUs of a model measure along a simulated trial."""

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from btr_mjx.models import part_names

NOISE, BIAS = {"gyro": 5e-3, "accelerometer": 0.1}, {"gyro": 2e-3, "accelerometer": 0.03}
"""Standard deviations of the noise, and of the bias of a trial [rad/s], [m/s^2]."""
_KINDS = {int(mujoco.mjtSensor.mjSENS_GYRO): "gyro", int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "accelerometer"}


def imu_readings(
    model: mujoco.MjModel, times: np.ndarray, qpos: np.ndarray, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Readings of the gyros and accelerometers of a model, as averages over two sampling intervals.

    Args:
      model: the model, whose sensors are at sites.
      times: (K,) evenly spaced [s].
      qpos: (K, nq) configurations without noise.
      rng: of noise and biases.

    Returns:
      (K,) by "NAME/x", "NAME/y" and "NAME/z"; empty where the model has no such sensor.
    """
    sensors = [i for i, kind in enumerate(model.sensor_type) if int(kind) in _KINDS]
    if not sensors:
        return {}
    data, names, out = mujoco.MjData(model), part_names(model, "sensor"), dict[str, np.ndarray]()
    count, sites = len(times), model.sensor_objid[sensors]
    places, turns = np.empty((count, len(sensors), 3)), np.empty((count, len(sensors), 3, 3))
    for k in range(count):
        data.qpos[:] = qpos[k]
        mujoco.mj_kinematics(model, data)
        places[k], turns[k] = data.site_xpos[sites], data.site_xmat[sites].reshape(-1, 3, 3)
    at, interval = np.clip(np.arange(count), 1, count - 2), float(times[1] - times[0])
    for column, sensor in enumerate(sensors):
        turn, place, kind = Rotation.from_matrix(turns[:, column]), places[:, column], _KINDS[model.sensor_type[sensor]]
        if kind == "gyro":
            values = (turn[at - 1].inv() * turn[at + 1]).as_rotvec() / (2 * interval)
        else:
            felt = (place[at + 1] - 2 * place[at] + place[at - 1]) / interval**2 - model.opt.gravity
            values = turn[at].inv().apply(felt)
        values = values + BIAS[kind] * rng.standard_normal(3) + NOISE[kind] * rng.standard_normal(values.shape)
        out |= {f"{names[sensor]}/{axis}": values[:, i] for i, axis in enumerate("xyz")}
    return out
