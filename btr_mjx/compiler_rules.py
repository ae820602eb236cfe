"""What MuJoCo's compiler computes from a geom's attributes, for many geoms and simulations at a time.

Source: google-deepmind/mujoco, src/user/user_objects.cc (mjCGeom::Compile, GetVolume, SetInertia, ComputeAABB,
mjCBody::InertiaFromGeom) and src/user/user_util.cc. Every formula keeps the compiler's order of operations and uses
elementwise arithmetic only, so that results are the compiler's to the bit and do not depend on the batch. Vectors are
stacks of components along the first axis: (3, ...), quaternions (4, ...) with the real part first.
"""

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from btr_mjx.symbolic import elementwise

EPS = 1e-14
"""The compiler's threshold below which a length, mass, volume or moment counts as zero (mjEPS)."""

_JACOBI_EPS = 1e-12

SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
)
SIZES = {SPHERE: 1, CAPSULE: 2, ELLIPSOID: 3, CYLINDER: 2, BOX: 3}
"""The kinds of geom that these rules cover, and how many sizes each has; they must be positive."""


def normalized(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors and the lengths that vectors (n, ...) had (mjuu_normvec): 0 where they were too short to change."""
    square = vector[0] * vector[0]
    for x in vector[1:]:
        square = square + x * x
    length = np.sqrt(square)
    short = square < EPS
    unit = np.where(short | (np.abs(length - 1) <= EPS), vector, vector / np.where(short, 1.0, length))
    return unit, np.where(short, 0.0, length)


def frame_between(ends: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, orientation and half length of geoms given by their two end points (`fromto`).

    Args:
      ends: (6, ...) end points.

    Returns:
      (3, ...) centre, (4, ...) the smallest rotation that takes the z axis along the geom, (...) half length.
    """
    direction, length = normalized(ends[:3] - ends[3:])
    x, y, z = direction
    axis, sine = normalized(np.stack([0.0 * z - 1.0 * y, 1.0 * x - 0.0 * z, 0.0 * y - 0.0 * x]))
    upright = np.reshape([1.0, 0.0, 0.0], (3,) + (1,) * sine.ndim)
    axis = np.where(sine < 1e-10, upright, axis)
    half = elementwise(math.atan2, sine, z) / 2
    quaternion = np.concatenate([elementwise(math.cos, half)[None], axis * elementwise(math.sin, half)])
    return (ends[:3] + ends[3:]) / 2, quaternion, length / 2


def volume(kind: int, size: np.ndarray) -> np.ndarray:
    """Volumes (...) of geoms of one kind with sizes (3, ...)."""
    a, b, c = size
    if kind == SPHERE:
        return 4 * math.pi * a * a * a / 3
    if kind == CAPSULE:
        return math.pi * (a * a * (2 * b) + 4 * a * a * a / 3)
    if kind == CYLINDER:
        return math.pi * a * a * (2 * b)
    if kind == ELLIPSOID:
        return 4 * math.pi * a * b * c / 3
    return a * b * c * 8


def inertia(kind: int, mass: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Principal moments (3, ...) of solid geoms of one kind with masses (...) and sizes (3, ...)."""
    a, b, c = size
    if kind == SPHERE:
        return np.stack([2 * mass * a * a / 5] * 3)
    if kind == CAPSULE:
        height = 2 * b
        ball = mass * 4 * a / (4 * a + 3 * height)
        rod = mass - ball
        caps = 2 * ball * a * a / 5
        # The compiler adds the caps in this order.
        across = rod * (3 * a * a + height * height) / 12 + (caps + ball * height * (3 * a + 2 * height) / 8)
        return np.stack([across, across, rod * a * a / 2 + caps])
    if kind == CYLINDER:
        height = 2 * b
        across = mass * (3 * a * a + height * height) / 12
        return np.stack([across, across, mass * a * a / 2])
    aa, bb, cc = a * a, b * b, c * c
    share = 5 if kind == ELLIPSOID else 3
    return np.stack([mass * (bb + cc) / share, mass * (aa + cc) / share, mass * (aa + bb) / share])


def bounding_box(kind: int, size: np.ndarray) -> np.ndarray:
    """Centre and half sides (6, ...) of the boxes around geoms of one kind with sizes (3, ...), in the geom's frame."""
    a, b, c = size
    half = {
        SPHERE: lambda: (a, a, a),
        CAPSULE: lambda: (a, a, a + b),
        CYLINDER: lambda: (a, a, b),
    }.get(kind, lambda: (a, b, c))()
    zero = np.zeros_like(a)
    return np.stack([zero, zero, zero, *half])


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (9, ...), row by row, of quaternions (4, ...) (mjuu_quat2mat)."""
    q = [[a * b for b in quaternion] for a in quaternion]
    regular = np.stack(
        [
            q[0][0] + q[1][1] - q[2][2] - q[3][3],
            2 * (q[1][2] - q[0][3]),
            2 * (q[1][3] + q[0][2]),
            2 * (q[1][2] + q[0][3]),
            q[0][0] - q[1][1] + q[2][2] - q[3][3],
            2 * (q[2][3] - q[0][1]),
            2 * (q[1][3] - q[0][2]),
            2 * (q[2][3] + q[0][1]),
            q[0][0] - q[1][1] - q[2][2] + q[3][3],
        ]
    )
    unit = np.reshape(np.eye(3), (9,) + (1,) * (quaternion.ndim - 1))
    none = (quaternion[0] == 1) & (quaternion[1] == 0) & (quaternion[2] == 0) & (quaternion[3] == 0)
    return np.where(none, unit, regular)


def _product(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> np.ndarray:
    """Products (9, ...) of matrices (9, ...)."""
    return np.stack(
        [a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j] for i in range(3) for j in range(3)]
    )


def _times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Normalised products (4, ...) of quaternions (4, ...) (mjuu_mulquat)."""
    product = np.stack(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )
    return normalized(product)[0]


def merged(
    masses: np.ndarray, positions: np.ndarray, quaternions: np.ndarray, moments: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mass, centre, principal axes and moments of bodies of several geoms (mjCBody::InertiaFromGeom).

    Args:
      masses: (G, L) of each body's G geoms.
      positions: (3, G, L).
      quaternions: (4, G, L).
      moments: (3, G, L) in the geoms' frames.

    Returns:
      (L,) mass, (3, L) centre, (4, L) orientation of the principal axes, (3, L) principal moments in falling order.
    """
    mass, centre = masses[0], masses[0] * positions[:, 0]
    for m, p in zip(masses[1:], positions.swapaxes(0, 1)[1:], strict=True):
        mass, centre = mass + m, centre + m * p
    centre = centre / mass
    total = np.zeros((6, *mass.shape))
    for g, m in enumerate(masses):
        r, i = _matrix(quaternions[:, g]), moments[:, g]
        # Upper triangle of R diag(i) R', in the order xx, yy, zz, xy, xz, yz.
        turned = np.stack(
            [
                r[3 * a] * (r[3 * b] * i[0])
                + r[3 * a + 1] * (r[3 * b + 1] * i[1])
                + r[3 * a + 2] * (r[3 * b + 2] * i[2])
                for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
            ]
        )
        x, y, z = positions[:, g] - centre
        shifted = np.stack(
            [m * (y * y + z * z), m * (x * x + z * z), m * (x * x + y * y), -m * x * y, -m * x * z, -m * y * z]
        )
        total = total + turned + shifted
    moments, axes = principal_axes(total)
    return mass, centre, axes, moments


def principal_axes(full: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and the quaternion of the eigenvectors of symmetric matrices (mjuu_eig3).

    Args:
      full: (6, L) elements xx, yy, zz, xy, xz, yz.

    Returns:
      (3, L) eigenvalues in falling order and (4, L) quaternions, in MuJoCo's convention of order and sign.
    """
    xx, yy, zz, xy, xz, yz = full
    matrix = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz])
    count = full.shape[1]
    quaternion, values = np.zeros((4, count)), np.zeros((3, count))
    quaternion[0] = 1
    turning = np.arange(count)  # lanes that have not converged: each goes on for as long as it would alone
    for _ in range(500):
        diagonal, step, found = _jacobi(matrix[:, turning], quaternion[:, turning])
        values[:, turning] = diagonal
        turning, step = turning[found], step[:, found]
        if not len(turning):
            break
        quaternion[:, turning] = normalized(_times(quaternion[:, turning], step))[0]
    root = 0.707106781186548  # as the compiler has it, to this number of digits
    for lead in (0, 1, 0):  # bubble sort
        swap = values[lead] + _JACOBI_EPS < values[lead + 1]
        values[lead], values[lead + 1] = (
            np.where(swap, values[lead + 1], values[lead]),
            np.where(swap, values[lead], values[lead + 1]),
        )
        step = np.zeros((4, count))
        step[0] = step[(lead + 2) % 3 + 1] = root
        quaternion = np.where(swap, normalized(_times(quaternion, step))[0], quaternion)
    return values, quaternion


def _jacobi(matrix: np.ndarray, quaternion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One Jacobi rotation: the present diagonal (3, L), the rotation (4, L), and whether one is still needed (L,)."""
    axes = _matrix(quaternion)
    transposed = axes[[0, 3, 6, 1, 4, 7, 2, 5, 8]]
    d = _product(_product(transposed, matrix), axes)
    first = (np.abs(d[1]) > np.abs(d[2])) & (np.abs(d[1]) > np.abs(d[5]))
    second = ~first & (np.abs(d[2]) > np.abs(d[5]))
    pick = lambda a, b, c: np.where(first, a, np.where(second, b, c))  # noqa: E731
    off = pick(d[1], d[2], d[5])
    large = np.abs(off) >= _JACOBI_EPS
    tau = (pick(d[4], d[8], d[8]) - pick(d[0], d[0], d[4])) / (2 * np.where(large, off, 1.0))
    rising = tau >= 0
    root = np.sqrt(1 + tau * tau)
    tangent = np.where(rising, 1.0 / (tau + root), -1.0 / (-tau + root))
    cosine = 1.0 / np.sqrt(1 + tangent * tangent)
    small = np.sqrt(np.where(cosine < 1, 0.5 - 0.5 * cosine, 0.0))
    part = np.where(rising, -small, small)
    part = np.where(second, -part, part)
    zero = np.zeros_like(part)
    step = np.stack(
        [np.sqrt(1.0 - part * part), pick(zero, zero, part), pick(zero, part, zero), pick(part, zero, zero)]
    )
    return d[[0, 4, 8]], normalized(step)[0], large & ~(cosine > 1.0 - _JACOBI_EPS)
