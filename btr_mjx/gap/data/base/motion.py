"""What is measured of a base without a pose, and the estimate of its motion."""

from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from btr_mjx.gap.data.base.touching import Touching, touching_points

N, COMMON = 9, 10
"""Unknowns of a sample: place, velocity and orientation; unknowns beside them: how the unit is turned, how late it is,
its biases."""
TOUCH_MARGIN = 0.02
"""Largest distance of a point that may touch [m]."""
_PICKED = 20
"""Samples at which the depth of feet is computed."""
_LOW, _HALF = 3e-3, 4
"""Points that are this close to the lowest one stand at first [m]; half width of a moving average [samples]."""


@dataclass(frozen=True, eq=False)
class MeasuredBase:
    """A base that was measured, K samples, beside its unit.

    Attributes:
      place: (K, 3) [m], turn: (K,) orientations, velocity: (K, 3) in the world [m/s].
      sigma: (9,) noise of place, velocity and orientation; infinite where it was not measured.
    """

    place: np.ndarray
    turn: Rotation
    velocity: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, eq=False)
class Unit:
    """Inertial unit of a recording.

    Attributes:
      time: (K,) [s].
      gyro: (K, 3) [rad/s], accelerometer: (K, 3) [m/s^2].
      orientation: (K,) rotations of the unit in the world; None if it has no such estimate.
      noise: of gyro and accelerometer.
      pose: of the base, where it was measured.
    """

    time: np.ndarray
    gyro: np.ndarray
    accelerometer: np.ndarray
    orientation: Rotation | None
    noise: tuple[float, float]
    pose: MeasuredBase | None = None

    def earlier(self, late: float) -> "Unit":
        """The same unit, whose measurements were logged `late` seconds after they were made."""
        if late == 0.0:
            return self
        time, at = self.time, np.clip(self.time + late, self.time[0], self.time[-1])
        gyro, accelerometer = (
            np.stack([np.interp(at, time, own) for own in values.T], 1) for values in (self.gyro, self.accelerometer)
        )
        orientation = None if self.orientation is None else Slerp(time, self.orientation)(at)
        return replace(self, gyro=gyro, accelerometer=accelerometer, orientation=orientation)


@dataclass(frozen=True, eq=False)
class Legs:
    """What encoders measure in a recording, and the model in which it is put together.

    Attributes:
      model: the believed model.
      base: body with the free joint.
      place: (3,) of the unit in the frame of the base [m].
      qpos, qvel: (K, nq), (K, nv); those of the base are ignored.
      sigma: (2 nv,) noise of encoders.
    """

    model: mujoco.MjModel
    base: int
    place: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    sigma: np.ndarray

    def posed(self, place: np.ndarray, turn: Rotation) -> np.ndarray:
        """(K, nq) configurations with places (K, 3) of the unit and orientations of the base."""
        at = int(self.model.jnt_qposadr[self.model.body_jntadr[self.base]])
        qpos = self.qpos.copy()
        qpos[:, at : at + 3] = place - turn.apply(self.place)
        qpos[:, at + 3 : at + 7] = turn.as_quat(scalar_first=True)
        return qpos

    @property
    def arm(self) -> float:
        """Usual distance from the base to what touches the ground [m]: half the size of the robot in its first pose."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.qpos[0]
        mujoco.mj_kinematics(self.model, data)
        bodies = self.model.body_rootid == self.model.body_rootid[self.base]
        return float(np.abs(data.xpos[bodies] - data.xpos[self.base])[:, :2].max()) + 1e-3

    def softness(self, place: np.ndarray, turn: Rotation) -> float:
        """Depth to which one foot of the believed model sinks that carries its weight alone [m], the median of samples.

        Found at rest, where all points that are as deep share the weight.
        """
        model, data = self.model, mujoco.MjData(self.model)
        joint = int(model.body_jntadr[self.base])
        height, lift = int(model.jnt_qposadr[joint]) + 2, int(model.jnt_dofadr[joint]) + 2
        weight = -model.opt.gravity[2] * model.body_subtreemass[self.base]
        depths = []
        for qpos in self.posed(place, turn)[np.linspace(0, len(place) - 1, _PICKED).astype(int)]:
            low, high = 0.0, TOUCH_MARGIN
            while high - low > 1e-5:
                data.qpos[:], data.qvel[:], data.qacc[:] = qpos, 0.0, 0.0
                data.qpos[height] -= 0.5 * (low + high)
                mujoco.mj_inverse(model, data)
                enough = data.qfrc_constraint[lift] > weight
                low, high = (low, 0.5 * (low + high)) if enough else (0.5 * (low + high), high)
            depths.append(high * sum(contact.dist < 0 for contact in data.contact))
        return float(np.median(depths))

    def points(self, place: np.ndarray, turn: Rotation, margin: float = TOUCH_MARGIN) -> Touching:
        """Points near the ground, see `touching_points`."""
        qpos = self.posed(place, turn)
        return touching_points(self.model, self.base, self.place, qpos, self.qvel, self.sigma, margin)


@dataclass(frozen=True)
class Scatter:
    """Residuals of one kind: standard deviation, and the number of samples that are worth one independent sample."""

    sigma: float
    alike: float = 1.0


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """Estimate of a recording.

    Attributes:
      place, velocity: (K, 3) of the unit in the world [m], [m/s].
      turn: (K,) orientations of the base.
      softness: depth of a point that carries the robot's weight alone [m].
      carrying: (K,) number of points that carry it.
      biases: (6,) of gyro [rad/s] and accelerometer [m/s^2].
      slip, gap, tilt: scatter of velocities [m/s] and distances [m] of points that touch, and of orientations [rad].
      spread: (9,) standard deviations of the estimate at a sample (root mean square): place, velocity, orientation.
      within: (9,) of its change over `lag` samples, over the square root of two.
    """

    place: np.ndarray
    velocity: np.ndarray
    turn: Rotation
    biases: np.ndarray
    softness: float
    carrying: np.ndarray
    slip: Scatter = Scatter(0.2)
    gap: Scatter = Scatter(0.005)
    tilt: Scatter = Scatter(0.01)
    spread: np.ndarray = field(default_factory=lambda: np.zeros(N))
    within: np.ndarray = field(default_factory=lambda: np.zeros(N))


def first_estimate(unit: Unit, legs: Legs, mount: Rotation) -> BaseMotion:
    """A first estimate: the lowest point touches the ground and stands still."""
    count, step = len(unit.time), np.diff(unit.time)[:, None]
    spin = mount.apply(unit.gyro)
    if unit.pose is not None:
        turn, velocity = unit.pose.turn, unit.pose.velocity + unit.pose.turn.apply(np.cross(spin, legs.place))
        place = unit.pose.place + unit.pose.turn.apply(legs.place)
        return BaseMotion(place, velocity, turn, np.zeros(6), legs.softness(place, turn), np.full(count, 2.0))
    if unit.orientation is not None:
        turn = unit.orientation * mount.inv()
    else:
        # The mean of the specific force points upwards, as velocities stay small.
        now, turns = Rotation.identity(), []
        for moved in [np.zeros(3), *(0.5 * step * (spin[1:] + spin[:-1]))]:
            now = now * Rotation.from_rotvec(moved)
            turns.append(now)
        turn = Rotation.concatenate(turns)
        up = turn.apply(mount.apply(unit.accelerometer)).mean(0)
        turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0] * turn
    place = np.tile([0.0, 0.0, 1.0], (count, 1))
    points = legs.points(place, turn, 10.0)
    lowest = np.full(count, np.inf)
    np.minimum.at(lowest, points.sample, points.distance)
    place[:, 2] -= lowest
    low = points.distance < lowest[points.sample] + _LOW
    sample = points.sample[low]
    speed = np.cross(spin[sample], points.place[low]) + points.velocity[low]
    velocity = np.zeros((count, 3))
    np.add.at(velocity, sample, -turn[sample].apply(speed))
    velocity /= np.bincount(sample, minlength=count)[:, None]
    padded = np.pad(velocity, ((_HALF, _HALF), (0, 0)), "edge")
    velocity = np.stack([np.convolve(own, np.ones(2 * _HALF + 1) / (2 * _HALF + 1), "valid") for own in padded.T], 1)
    place[1:, :2] = np.cumsum(0.5 * step * (velocity[1:] + velocity[:-1]), axis=0)[:, :2]
    softness, carrying = legs.softness(place, turn), np.bincount(sample, minlength=count).astype(float)
    place[:, 2] -= softness / carrying
    return BaseMotion(place, velocity, turn, np.zeros(6), softness, carrying)
