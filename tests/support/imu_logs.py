"""A quadruped with an IMU on its trunk, simulated, and what its log says."""

from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from btr_mjx.gap.data import Dataset, Recording, make_recording
from btr_mjx.gap.data.columns.model_columns import control_columns, sensor_parts, state_columns
from btr_mjx.models import integrate

SENSORS = (
    '<sensor><gyro name="imu_gyro" site="imu"/><accelerometer name="imu_acc" site="imu"/>'
    '<framequat name="imu_quat" objtype="site" objname="imu"/></sensor>'
)
POSE = tuple(f"qpos/root/{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz"))
_ASSET = Path(__file__).parents[2] / "assets" / "quadruped.xml"


def quadruped(sensors: str = SENSORS, quat: str = "0.966 0 0 0.259") -> str:
    """The MJCF, with an IMU that is turned by 30 degrees against the trunk."""
    text = _ASSET.read_text()
    text = text.replace(
        '<freejoint name="root"/>', f'<freejoint name="root"/><site name="imu" quat="{quat}" pos="0.05 0 0.06"/>'
    )
    return text.replace("</actuator>", f"</actuator>{sensors}")


def walk(
    seconds: float = 6.0, seed: int = 0, mount: Rotation | None = None, reach: float = 0.12
) -> dict[str, np.ndarray]:
    """Columns of a walk, every 4 ms, with noise and biases; of an IMU that is mounted with an error.

    `reach` is how far joints are sent [rad].
    """
    model = mujoco.MjModel.from_xml_string(quadruped())
    if mount is not None:
        own = Rotation.from_quat(model.site_quat[0], scalar_first=True) * mount
        model.site_quat[0] = own.as_quat(scalar_first=True)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    speed, phase = rng.uniform(6, 12, model.nu), rng.uniform(0, 6, model.nu)
    count = round(seconds / 0.004)
    time = 0.004 * np.arange(count)
    ctrl = np.minimum(time, 1.0)[:, None] * reach * np.sin(speed * time[:, None] + phase)
    qpos, qvel, sensed = np.empty((count, model.nq)), np.empty((count, model.nv)), np.empty((count, model.nsensordata))
    for k in range(count):
        data.ctrl[:] = ctrl[k]
        mujoco.mj_forward(model, data)
        qpos[k], qvel[k], sensed[k] = data.qpos, data.qvel, data.sensordata
        for _ in range(4):
            mujoco.mj_step(model, data)
    size = np.r_[np.full(3, 5e-4), np.full(3, 1e-3), np.full(12, 2e-4)]
    qpos = integrate(model, qpos, size * rng.standard_normal(qvel.shape))
    sensed[:, :3] += 0.02 * rng.standard_normal(3) + 0.01 * rng.standard_normal((count, 3))
    sensed[:, 3:6] += 0.1 * rng.standard_normal(3) + 0.1 * rng.standard_normal((count, 3))
    every = [column for own in sensor_parts(model).values() for column in own]
    columns = {"time": time} | dict(zip(control_columns(model), ctrl.T, strict=True))
    columns |= dict(zip(state_columns(model)[0], qpos.T, strict=True))
    return columns | dict(zip(every, sensed.T.copy(), strict=True))


def dataset(columns: dict[str, np.ndarray], xml: str = "") -> Dataset:
    """One recording of these columns, of the robot as it is believed to be."""
    xml = xml or quadruped()
    model = mujoco.MjModel.from_xml_string(xml)
    recording: Recording = make_recording(columns, model, "walk.csv", "walk")
    return Dataset(Path("walk"), model, Path("robot.xml"), xml, (), (recording,))
