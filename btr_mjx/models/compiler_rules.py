"""Rules of MuJoCo's compiler for geoms and body inertias, vectorised over geoms and simulations.

Source: google-deepmind/mujoco, src/user/user_objects.cc (mjCGeom::Compile, GetVolume, SetInertia,
mjCBody::InertiaFromGeom) and src/user/user_util.cc. Every formula keeps the compiler's order of operations and uses
elementwise arithmetic only, so that results equal the compiler's to the bit (principal axes: to rounding) and do not
depend on the batch. Vectors are stacks of components along the first axis: (3, ...), quaternions (4, ...) with the real
part first.
"""

import math

import mujoco
import numpy as np

from btr_mjx.models.symbolic import elementwise

EPS = 1e-14
"""The compiler's threshold below which a length, mass, volume or moment counts as zero (mjEPS)."""

GEOM_SPHERE, GEOM_CAPSULE, GEOM_ELLIPSOID, GEOM_CYLINDER, GEOM_BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
)
SIZES = {GEOM_SPHERE: 1, GEOM_CAPSULE: 2, GEOM_ELLIPSOID: 3, GEOM_CYLINDER: 2, GEOM_BOX: 3}
"""Types of geoms that these rules cover -> number of their sizes, which must be positive."""


def normalized(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors and lengths of vectors (n, ...) (mjuu_normvec); short vectors are not changed, with length 0."""
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
      ends: (6, ...) end points [m].

    Returns:
      (3, ...) centre, (4, ...) smallest rotation from the z axis to the geom's axis, (...) half length.
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
    if kind == GEOM_SPHERE:
        return 4 * math.pi * a * a * a / 3
    if kind == GEOM_CAPSULE:
        return math.pi * (a * a * (2 * b) + 4 * a * a * a / 3)
    if kind == GEOM_CYLINDER:
        return math.pi * a * a * (2 * b)
    if kind == GEOM_ELLIPSOID:
        return 4 * math.pi * a * b * c / 3
    return a * b * c * 8


def geom_inertia(kind: int, mass: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Principal moments of inertia (3, ...) of solid geoms of one kind with masses (...) and sizes (3, ...)."""
    a, b, c = size
    if kind == GEOM_SPHERE:
        return np.stack([2 * mass * a * a / 5] * 3)
    if kind == GEOM_CAPSULE:
        height = 2 * b
        ball = mass * 4 * a / (4 * a + 3 * height)
        rod = mass - ball
        caps = 2 * ball * a * a / 5
        # The compiler adds the caps in this order.
        across = rod * (3 * a * a + height * height) / 12 + (caps + ball * height * (3 * a + 2 * height) / 8)
        return np.stack([across, across, rod * a * a / 2 + caps])
    if kind == GEOM_CYLINDER:
        height = 2 * b
        across = mass * (3 * a * a + height * height) / 12
        return np.stack([across, across, mass * a * a / 2])
    aa, bb, cc = a * a, b * b, c * c
    share = 5 if kind == GEOM_ELLIPSOID else 3
    return np.stack([mass * (bb + cc) / share, mass * (aa + cc) / share, mass * (aa + bb) / share])


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


def merge_inertias(
    masses: np.ndarray, positions: np.ndarray, quaternions: np.ndarray, moments: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mass, centre of mass, principal axes and moments of bodies with several geoms (mjCBody::InertiaFromGeom).

    Args:
      masses: (G, L) of each body's G geoms.
      positions: (3, G, L).
      quaternions: (4, G, L).
      moments: (3, G, L) in the geoms' frames.

    Returns:
      (L,) mass, (3, L) centre, (4, L) orientation of the principal axes, (3, L) principal moments in descending order.
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
    """Eigenvalues and the quaternion of the eigenvectors of symmetric matrices.

    Uses MuJoCo's own iteration (mju_eig3), one matrix at a time, which fixes the order and the signs of the axes. The
    compiler has a variant of it that normalises at other places: quaternions agree to a few 1e-15.

    Args:
      full: (6, L) elements xx, yy, zz, xy, xz, yz.

    Returns:
      (3, L) eigenvalues in descending order and (4, L) quaternions.
    """
    matrices = np.ascontiguousarray(full[[0, 3, 4, 3, 1, 5, 4, 5, 2]].T)
    values, quaternions, vectors = np.empty((len(matrices), 3)), np.empty((len(matrices), 4)), np.empty(9)
    for matrix, value, quaternion in zip(matrices, values, quaternions, strict=True):
        mujoco.mju_eig3(value, vectors, quaternion, matrix)
    return values.T, quaternions.T
