"""Measurements of an inertial unit on a robot's base, from states of its reality without noise, and faults of logs."""

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
FAULTS = ("jitter", "lost", "late", "held", "lowpass", "coarse")
"""Faults of logs: time stamps that come late by 0.8 ms on average; missing rows; an inertial unit that is one row late;
one that is read in every second row; joint velocities behind a filter of 10 ms; encoders of 5 mrad."""
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


def with_fault(columns: dict[str, np.ndarray], fault: str, joints: tuple[str, ...], rng: np.random.Generator) -> None:
    """Give (K,) columns of a log of some joints one of `FAULTS`."""
    time = columns["time"].copy()
    count, unit = len(time), [name for name in columns if name.startswith("sensor/")]
    if fault == "jitter":
        late = time + rng.exponential(8e-4, count) + 4e-3 * (rng.random(count) < 0.01)
        columns["time"] = np.maximum.accumulate(late) + 1e-6 * np.arange(count)
    if fault == "lost":
        kept = rng.random(count) >= 0.01
        first = int(rng.integers(count // 4, 3 * count // 4))
        kept[first : first + int(rng.integers(4, 30))] = False
        columns.update({name: values[kept] for name, values in columns.items()})
    if fault in ("late", "held"):
        rows = np.arange(count)
        rows = np.maximum(rows - 1, 0) if fault == "late" else rows - rows % 2
        columns.update({name: columns[name][rows] for name in unit})
    if fault == "lowpass":
        part = 1 - np.exp(-np.diff(time) / 0.01)
        for name in (f"qvel/{joint}" for joint in joints):
            values = columns[name].copy()
            for i in range(1, count):
                values[i] = values[i - 1] + part[i - 1] * (values[i] - values[i - 1])
            columns[name] = values
    if fault == "coarse":
        columns.update({name: np.round(columns[name] / 5e-3) * 5e-3 for name in (f"qpos/{j}" for j in joints)})
