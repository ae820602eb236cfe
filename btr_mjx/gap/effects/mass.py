"""Mass properties of bodies and solid geoms: mass, centre of mass, inertia tensor."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

_GEOM = mujoco.mjtGeom
_LONG = (int(_GEOM.mjGEOM_CAPSULE), int(_GEOM.mjGEOM_CYLINDER))
_BOXED = (int(_GEOM.mjGEOM_BOX), int(_GEOM.mjGEOM_ELLIPSOID))


@dataclass(frozen=True)
class MassProperties:
    """Mass properties of a body in its own frame.

    Attributes:
      mass: [kg].
      centre: (3,) centre of mass [m].
      inertia: (3, 3) about the centre of mass, in the axes of the body [kg m^2].
    """

    mass: float
    centre: np.ndarray
    inertia: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, body: int) -> "MassProperties":
        """Mass properties of a body of a model."""
        turn = rotation_matrix(model.body_iquat[body])
        inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
        return cls(float(model.body_mass[body]), model.body_ipos[body].copy(), inertia)

    def plus(self, other: "MassProperties") -> "MassProperties":
        """Mass properties of both together."""
        mass = self.mass + other.mass
        if mass == 0:
            return self
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        inertia = np.zeros((3, 3))
        for part in (self, other):
            inertia += part.inertia + part.mass * _spread(part.centre - centre)
        return MassProperties(mass, centre, inertia)

    def scaled(self, factor: float) -> "MassProperties":
        """Those of a body of the same shape and another density."""
        return MassProperties(max(factor, 0.0) * self.mass, self.centre, max(factor, 0.0) * self.inertia)

    def write(self, model: mujoco.MjModel, body: int) -> None:
        """Write to a body of a model, with principal moments made physical (positive, triangle inequality)."""
        moments, axes = np.linalg.eigh(self.inertia)
        moments = np.maximum(moments, 1e-9 * max(float(moments.max()), 1e-12))
        moments[2] = min(moments[2], moments[0] + moments[1])
        if np.linalg.det(axes) < 0:
            axes[:, 0] *= -1
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, axes.flatten())
        model.body_mass[body] = max(self.mass, 1e-9)
        model.body_ipos[body] = self.centre
        model.body_inertia[body] = moments
        model.body_iquat[body] = quaternion
        clear_sameframe(model, body)


def point_mass(mass: float, position: np.ndarray) -> MassProperties:
    """Mass properties of a point mass [kg] at a position (3,) [m]."""
    return MassProperties(mass, np.asarray(position, float), np.zeros((3, 3)))


def clear_sameframe(model: mujoco.MjModel, body: int) -> None:
    """Clear MuJoCo's sameframe flags of a body, its geoms and sites, as their frames may not coincide any more."""
    model.body_sameframe[body] = 0
    model.geom_sameframe[model.geom_bodyid == body] = 0
    model.site_sameframe[model.site_bodyid == body] = 0


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """(3, 3) rotation matrix of a quaternion (w, x, y, z)."""
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, np.asarray(quaternion, float))
    return flat.reshape(3, 3)


def long_axis(model: mujoco.MjModel, geom: int, direction: np.ndarray) -> tuple[int, float] | None:
    """The axis of a geom that is parallel to a direction (cosine above 0.9).

    Args:
      model: the model.
      geom: its id.
      direction: (3,) unit vector in the body frame.

    Returns:
      Index of the axis in `geom_size`, and half its length [m]; None if no axis is parallel or the shape has none.
    """
    kind, turn = int(model.geom_type[geom]), rotation_matrix(model.geom_quat[geom])
    along = np.abs(turn.T @ direction)
    if kind in _LONG and along[2] > 0.9:
        return 1, float(model.geom_size[geom, 1])
    if kind in _BOXED and along.max() > 0.9:
        axis = int(along.argmax())
        return axis, float(model.geom_size[geom, axis])
    return None


def axis_vector(model: mujoco.MjModel, geom: int, axis: int) -> np.ndarray:
    """(3,) unit vector in the body frame of an axis that `long_axis` returned."""
    column = 2 if int(model.geom_type[geom]) in _LONG else axis
    return rotation_matrix(model.geom_quat[geom])[:, column]


def geoms_at_density(model: mujoco.MjModel, geoms: Sequence[int], density: float) -> MassProperties:
    """Mass properties of solid geoms of uniform density [kg/m^3], in the body frame."""
    total = MassProperties(0.0, np.zeros(3), np.zeros((3, 3)))
    for geom in geoms:
        volume, moments = _solid(int(model.geom_type[geom]), model.geom_size[geom])
        turn = rotation_matrix(model.geom_quat[geom])
        inertia = density * turn @ np.diag(moments) @ turn.T
        total = total.plus(MassProperties(density * volume, model.geom_pos[geom].copy(), inertia))
    return total


def _solid(kind: int, size: np.ndarray) -> tuple[float, np.ndarray]:
    """Volume and principal moments of inertia at density 1."""
    a, b, c = (float(x) for x in size)
    if kind == int(_GEOM.mjGEOM_SPHERE):
        volume = 4 / 3 * np.pi * a**3
        return volume, np.full(3, 0.4 * volume * a**2)
    if kind in _BOXED:
        volume = 8 * a * b * c if kind == int(_GEOM.mjGEOM_BOX) else 4 / 3 * np.pi * a * b * c
        divisor = 3 if kind == int(_GEOM.mjGEOM_BOX) else 5
        return volume, volume / divisor * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    if kind not in _LONG:
        return 0.0, np.zeros(3)
    tube = np.pi * a * a * 2 * b
    across, along = tube * (3 * a * a + 4 * b * b) / 12, tube * a * a / 2
    if kind == int(_GEOM.mjGEOM_CYLINDER):
        return tube, np.array([across, across, along])
    caps = 4 / 3 * np.pi * a**3  # two half spheres, centroids 3/8 of the radius beyond the ends
    along += 0.4 * caps * a * a
    across += caps * (0.4 * a * a + b * b + 0.75 * a * b)
    return tube + caps, np.array([across, across, along])


def _spread(offset: np.ndarray) -> np.ndarray:
    """(3, 3) term of the parallel axis theorem for unit mass."""
    return offset @ offset * np.eye(3) - np.outer(offset, offset)
