"""Residuals of the motion of a base: inertial unit, orientation, and points that touch."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import softmax

from btr_mjx.gap.data.base.block_system import BlockRows
from btr_mjx.gap.data.base.motion import COMMON, TOUCH_MARGIN, BaseMotion, Legs, N, Scatter, Unit
from btr_mjx.gap.data.base.touching import Touching

_PLACE, _VELOCITY, _TURN = slice(0, 3), slice(3, 6), slice(6, 9)
_MOUNT, _LATE, _GYRO, _ACCELEROMETER = slice(0, 3), 3, slice(4, 7), slice(7, 10)
"""Unknowns of the border: how the unit is turned, how late it is, its biases."""
_SPEEDS, _DISTANCES = 3 * np.log(2.0), np.log(2 * TOUCH_MARGIN)
"""Logarithms of the volumes over which velocities (+- 1 m/s) and distances are spread of a point that is not held."""
_LEAST_SLIP, _LEAST_GAP, _LEAST_TILT = 1e-3, 2e-4, 1e-4
"""Smallest scatter that is estimated [m/s], [m], [rad]."""
_MOST_ALIKE = 0.98
"""Largest correlation of residuals from one sample to the next."""
_SPREAD = 1 / np.sqrt(12)
"""Standard deviation of a number that is anywhere within 1."""


@dataclass(frozen=True, eq=False)
class Inertia:
    """Angular velocity `spin` and specific force `force` (K, 3) in the frame of the base, and the mount (3, 3).

    `bend` (K, 3) is the slope of `spin` [rad/s^2].
    """

    spin: np.ndarray
    force: np.ndarray
    mount: np.ndarray
    bend: np.ndarray


def inertia_of(unit: Unit, motion: BaseMotion, mount: Rotation) -> Inertia:
    """Measurements of a unit without their biases, in the frame of the base."""
    spin, force = unit.gyro - motion.biases[:3], unit.accelerometer - motion.biases[3:]
    spin = mount.apply(spin)
    return Inertia(spin, mount.apply(force), mount.as_matrix(), np.gradient(spin, unit.time, axis=0))


def propagation(unit: Unit, motion: BaseMotion, inertia: Inertia, gravity: np.ndarray) -> BlockRows:
    """Each state against the one that follows from the state before: K - 1 rows."""
    count, step = len(unit.time) - 1, np.diff(unit.time)[:, None]
    turn, before, after = motion.turn.as_matrix(), motion.turn[:-1], motion.turn[1:]
    spin, pull = _mean_between(inertia.spin), _mean_between(motion.turn.apply(inertia.force))
    moved = Rotation.from_rotvec(spin * step)
    speeds = motion.velocity[:-1], motion.velocity[1:]
    residual = np.concatenate(
        [
            motion.place[:-1] + 0.5 * step * (speeds[0] + speeds[1]) - motion.place[1:],
            speeds[0] + step * (pull + gravity) - speeds[1],
            (after.inv() * before * moved).as_rotvec(),
        ],
        axis=1,
    )
    # What a sensor averages around a sample may have happened before or after it.
    rate, force = (_uneven(values) for values in (unit.gyro, unit.accelerometer))
    sigma_v = step[:, 0] * np.hypot(unit.noise[1], force)
    sigma = np.repeat([0.3 * step[:, 0] * sigma_v + 1e-6, sigma_v, step[:, 0] * np.hypot(unit.noise[0], rate)], 3, 0).T
    eye, h = np.eye(3), step[..., None]
    slope, ahead, border = np.zeros((count, N, N)), np.zeros((count, N, N)), np.zeros((count, N, COMMON))
    slope[:, _PLACE, _PLACE], ahead[:, _PLACE, _PLACE] = eye, -eye
    slope[:, _PLACE, _VELOCITY] = ahead[:, _PLACE, _VELOCITY] = 0.5 * h * eye
    slope[:, _VELOCITY, _VELOCITY], ahead[:, _VELOCITY, _VELOCITY] = eye, -eye
    lever = -turn @ _cross(inertia.force)
    slope[:, _VELOCITY, _TURN], ahead[:, _VELOCITY, _TURN] = 0.5 * h * lever[:-1], 0.5 * h * lever[1:]
    slope[:, _TURN, _TURN], ahead[:, _TURN, _TURN] = moved.inv().as_matrix(), -eye
    border[:, _VELOCITY, _MOUNT] = 0.5 * h * (lever[:-1] + lever[1:])
    border[:, _VELOCITY, _ACCELEROMETER] = -h * (turn[:-1] @ inertia.mount)
    border[:, _VELOCITY, _LATE] = motion.turn[:-1].apply(np.diff(inertia.force, axis=0))
    border[:, _TURN, _LATE] = np.diff(inertia.spin, axis=0)
    border[:, _TURN, _MOUNT] = -h * _cross(spin)
    border[:, _TURN, _GYRO] = -h * inertia.mount
    weight = 1 / sigma
    return BlockRows(
        residual * weight,
        np.arange(count),
        slope * weight[..., None],
        border * weight[..., None],
        ahead * weight[..., None],
    )


def tilts(unit: Unit, motion: BaseMotion, mount: Rotation) -> tuple[BlockRows, Scatter]:
    """Orientations that the unit reports: K rows, and their scatter after the last step."""
    assert unit.orientation is not None
    left = (motion.turn.inv() * unit.orientation * mount.inv()).as_rotvec()
    count = np.arange(len(left))
    scatter = scatter_of(left, (count[:-1], count[1:]), np.ones(len(left)), 0.0, _LEAST_TILT)
    sigma = motion.tilt.sigma * np.sqrt(motion.tilt.alike)
    slope, border = np.zeros((len(left), 3, N)), np.zeros((len(left), 3, COMMON))
    slope[:, :, _TURN] = border[:, :, _MOUNT] = -np.eye(3) / sigma
    border[:, :, _LATE] = mount.apply(unit.gyro - motion.biases[:3]) / sigma
    return BlockRows(left / sigma, np.arange(len(left)), slope, border), scatter


def poses(legs: Legs, unit: Unit, motion: BaseMotion, inertia: Inertia) -> BlockRows:
    """The motion against a pose of the base that was measured: K rows."""
    assert unit.pose is not None
    turn, arm, around = motion.turn.as_matrix(), _cross(legs.place), np.cross(inertia.spin, legs.place)
    residual = np.concatenate(
        [
            motion.place - motion.turn.apply(legs.place) - unit.pose.place,
            motion.velocity - motion.turn.apply(around) - unit.pose.velocity,
            (motion.turn.inv() * unit.pose.turn).as_rotvec(),
        ],
        axis=1,
    )
    count, eye = len(residual), np.eye(3)
    slope, border = np.zeros((count, N, N)), np.zeros((count, N, COMMON))
    slope[:, _PLACE, _PLACE], slope[:, _VELOCITY, _VELOCITY], slope[:, _TURN, _TURN] = eye, eye, -eye
    slope[:, _PLACE, _TURN], slope[:, _VELOCITY, _TURN] = turn @ arm, turn @ _cross(around)
    border[:, _VELOCITY, _MOUNT] = -turn @ arm @ _cross(inertia.spin)
    border[:, _VELOCITY, _GYRO] = -turn @ arm @ inertia.mount
    border[:, _VELOCITY, _LATE] = motion.turn.apply(np.cross(legs.place, inertia.bend))
    weight = 1 / unit.pose.sigma
    return BlockRows(residual * weight, np.arange(count), slope * weight[:, None], border * weight[:, None])


def touches(
    points: Touching, unit: Unit, motion: BaseMotion, inertia: Inertia, gravity: np.ndarray
) -> tuple[BlockRows, Scatter, Scatter, np.ndarray]:
    """Points that may touch, weighted with the probabilities that they stand, or slide.

    Returns:
      BlockRows, scatter of velocities and distances, and (K,) expected number of points that touch.
    """
    k, eye = points.sample, np.eye(3)
    turn, spin, arm = motion.turn.as_matrix()[k], inertia.spin[k], _cross(points.place)
    load = np.maximum(motion.turn.apply(inertia.force) @ -gravity / max(gravity @ gravity, 1e-9), 0.0)
    sunk = motion.softness * load / np.maximum(motion.carrying, 1.0)
    depth = points.distances(motion.place[k] + np.einsum("nij,nj->ni", turn, points.place)) + sunk[k]
    own, normal = (np.einsum("nji,nj->ni", turn, vector) for vector in (motion.velocity[k], points.normal))
    speed = own + np.cross(spin, points.place) + points.velocity
    by_gyro = unit.noise[0] ** 2 * arm @ np.swapaxes(arm, 1, 2)
    encoders, gaps = points.velocity_covariance + by_gyro, points.distance_variance

    def whitener(alike: float) -> np.ndarray:
        return np.linalg.inv(np.linalg.cholesky(encoders + alike * motion.slip.sigma**2 * eye))

    plain, narrow = whitener(1.0), np.sqrt(gaps + motion.gap.sigma**2)
    near = -0.5 * (depth / narrow) ** 2 - np.log(narrow) - 0.5 * np.log(2 * np.pi)
    still = -0.5 * (np.einsum("nij,nj->ni", plain, speed) ** 2).sum(1) + np.log(np.linalg.det(plain))
    still -= 1.5 * np.log(2 * np.pi)
    kinds = np.stack([near + still, near - _SPEEDS, np.full(len(k), -_SPEEDS - _DISTANCES)], 1)
    stands, slides, _ = softmax(kinds, axis=1).T
    touching = stands + slides
    whiten, wide = whitener(motion.slip.alike), np.sqrt(gaps + motion.gap.alike * motion.gap.sigma**2)
    slope, border = np.zeros((len(k), 4, N)), np.zeros((len(k), 4, COMMON))
    slope[:, :3, _VELOCITY], slope[:, :3, _TURN] = whiten @ np.swapaxes(turn, 1, 2), whiten @ _cross(own)
    border[:, :3, _MOUNT], border[:, :3, _GYRO] = whiten @ arm @ _cross(spin), whiten @ arm @ inertia.mount
    border[:, :3, _LATE] = np.einsum("nij,nj->ni", whiten, np.cross(inertia.bend[k], points.place))
    slope[:, 3, _PLACE] = points.normal / wide[:, None]
    slope[:, 3, _TURN] = -np.einsum("ni,nij->nj", normal, arm) / wide[:, None]
    residual = np.concatenate([np.einsum("nij,nj->ni", whiten, speed), (depth / wide)[:, None]], 1)
    weight = np.sqrt(np.stack([stands, stands, stands, touching], 1))
    rows = BlockRows(residual * weight, k, slope * weight[..., None], border * weight[..., None])
    first, then = _following(points.geom, k)
    world, distance = np.einsum("nij,nj->ni", turn, speed), depth[:, None]
    noise = np.trace(encoders, axis1=1, axis2=2)
    slip = scatter_of(world, (first, then), stands, noise, _LEAST_SLIP)
    gap = scatter_of(distance, (first, then), touching, gaps, _LEAST_GAP)
    return rows, slip, gap, np.bincount(k, touching, len(motion.place))


def scatter_of(
    values: np.ndarray,
    following: tuple[np.ndarray, np.ndarray],
    weight: np.ndarray,
    noise: np.ndarray | float,
    least: float,
) -> Scatter:
    """Scatter of residuals beyond a noise that is known, as a process of first order.

    Args:
      values: (n, d) residuals.
      following: indices (m,) of residuals, and of those one sample later.
      weight: (n,) of residuals.
      noise: (n,) known variance, the sum over d.
      least: smallest standard deviation.
    """
    before, after = (values[index] for index in following)
    pairs = weight[following[0]] * weight[following[1]]
    size = values.shape[1]
    variance = float((weight * ((values**2).sum(1) - noise)).sum() / max(size * weight.sum(), 1e-9))
    variance = max(variance, least**2)
    product = float((pairs * (before * after).sum(1)).sum() / max(size * pairs.sum(), 1e-9))
    correlation = min(max(product / variance, 0.0), _MOST_ALIKE)
    return Scatter(float(np.sqrt(variance)), (1 + correlation) / (1 - correlation))


def _following(geom: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of points of one geom in two samples that follow each other."""
    order = np.lexsort((sample, geom))
    same = (np.diff(geom[order]) == 0) & (np.diff(sample[order]) == 1)
    return order[:-1][same], order[1:][same]


def _mean_between(values: np.ndarray) -> np.ndarray:
    """(K - 1, d) means from each sample to the next, of the cubics through four samples around."""
    mean = 0.5 * (values[1:] + values[:-1])
    mean[1:-1] = (13 * (values[1:-2] + values[2:-1]) - values[:-3] - values[3:]) / 24
    return mean


def _uneven(values: np.ndarray) -> np.ndarray:
    """(K - 1,) how far the mean between two samples may be off, as what was averaged is not spread evenly."""
    bend = np.zeros(len(values))
    bend[1:-1] = np.sqrt(((values[1:-1] - 0.5 * (values[2:] + values[:-2])) ** 2).mean(1))
    return _SPREAD * 0.5 * (bend[1:] + bend[:-1])


def _cross(vectors: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrices of the cross product with vectors (..., 3)."""
    out = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j], out[..., j, i] = -vectors[..., k], vectors[..., k]
    return out
