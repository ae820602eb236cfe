"""Measurements of an inertial unit on the base of a robot, from states without noise of its reality."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

SITE = '<site name="imu" pos="0.05 0.02 0.03"/>'
PLACE = np.array([0.05, 0.02, 0.03])
"""Where the unit is in the base's frame [m]; its axes are believed to be those of the base."""
SENSORS = (
    '<sensor><gyro name="imu_gyro" site="imu"/><accelerometer name="imu_acc" site="imu"/>'
    '<framequat name="imu_quat" objtype="site" objname="imu"/></sensor>'
)
GYRO, ACCELEROMETER, ORIENTATION = 0.005, 0.1, 0.01
"""Noise: [rad/s], [m/s^2], [rad]."""
TILT = np.radians(2.0)
"""Angle by which the unit is turned on its base [rad], about an axis that is drawn."""


@dataclass(frozen=True)
class Mount:
    """A unit as it is: rotation from its frame to the base's, biases (3,) of gyro [rad/s] and accelerometer [m/s^2]."""

    turn: Rotation
    gyro: np.ndarray
    accelerometer: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Mount":
        """A unit that is turned by `TILT`."""
        axis = rng.standard_normal(3)
        turn = Rotation.from_rotvec(TILT * axis / np.linalg.norm(axis))
        return cls(turn, 0.003 * rng.standard_normal(3), 0.03 * rng.standard_normal(3))


def with_imu(xml: str, base: str) -> str:
    """MJCF text with a unit on a body, whose tag is given without its ending."""
    assert xml.count(base) == 1
    head, tail = xml.split(base)
    own, rest = tail.split(">", 1)
    return (head + base + own + ">" + SITE + rest).replace("</mujoco>", SENSORS + "</mujoco>")


def imu_columns(
    between: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, gravity: np.ndarray, mount: Mount, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Columns `sensor/...` of K samples of a robot whose first joint is the free one.

    Args:
      between: (K + 1,) times in the middle of samples, the first before the first sample [s].
      qpos: (2 K + 1, nq) configurations at these times and at the samples between them.
      qvel: (2 K + 1, nv) velocities there.
      gravity: (3,) of the reality [m/s^2].
      mount: the unit.
      rng: of the noise.

    Returns:
      Angular velocity and specific force, averaged from the middle before a sample to that after it, as filters of
      such units do, and orientation.
    """
    turned = Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
    speed = qvel[:, :3] + turned.apply(np.cross(qvel[:, 3:6], PLACE))
    force = np.diff(speed[::2], axis=0) / np.diff(between)[:, None] - gravity
    spin = 0.25 * (qvel[:-2:2, 3:6] + 2 * qvel[1::2, 3:6] + qvel[2::2, 3:6])
    at = turned[1::2]
    gyro = mount.turn.inv().apply(spin) + mount.gyro
    accelerometer = mount.turn.inv().apply(at.inv().apply(force)) + mount.accelerometer
    gyro = gyro + GYRO * rng.standard_normal(gyro.shape)
    accelerometer = accelerometer + ACCELEROMETER * rng.standard_normal(gyro.shape)
    noisy = at * mount.turn * Rotation.from_rotvec(ORIENTATION * rng.standard_normal(gyro.shape))
    quat = noisy.as_quat(scalar_first=True)
    columns = {f"sensor/imu_gyro/{axis}": gyro[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"sensor/imu_acc/{axis}": accelerometer[:, i] for i, axis in enumerate("xyz")}
    return columns | {f"sensor/imu_quat/q{axis}": quat[:, i] for i, axis in enumerate("wxyz")}
