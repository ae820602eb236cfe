"""Links: axis and length of a body from its joint to its far end, and change of the length."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.effects.mass import (
    MassProperties,
    axis_vector,
    clear_sameframe,
    geoms_at_density,
    long_axis,
    rotation_matrix,
)
from btr_mjx.gap.effects.places import ground_geoms


@dataclass(frozen=True)
class LinkAxis:
    """Axis of a body from its joint to its far end.

    Attributes:
      body: its id.
      anchor: (3,) position of the joint in the body frame [m].
      direction: (3,) unit vector from the joint to the far end.
      length: distance from the joint to the far end [m].
    """

    body: int
    anchor: np.ndarray
    direction: np.ndarray
    length: float

    def point(self, along: float) -> np.ndarray:
        """(3,) point on the axis at a distance from the joint [m]."""
        return self.anchor + along * self.direction


def link_of(model: mujoco.MjModel, body: int) -> LinkAxis | None:
    """The axis of a body with a joint.

    The far end is the mean of the child joints; without these, the farthest point of geoms that can touch the ground;
    without these, of all geoms.

    Args:
      model: the model.
      body: its id.

    Returns:
      The axis; None if the body has no joint or no extent.
    """
    if not model.body_jntnum[body]:
        return None
    anchor = model.jnt_pos[int(model.body_jntadr[body])].copy()
    parts = _welded_frames(model, body)
    tips = [
        origin + turn @ model.body_pos[child]
        for part, (origin, turn) in parts.items()
        for child in np.flatnonzero(model.body_parentid == part)
        if child and model.body_jntnum[child]
    ]
    if tips:
        tip = np.mean(tips, axis=0)
    else:
        points = _geom_points(model, parts, ground_geoms(model)[0]) or _geom_points(model, parts, None)
        if not points:
            return None
        tip = max(points, key=lambda point: float(np.linalg.norm(point - anchor)))
    length = float(np.linalg.norm(tip - anchor))
    if length < 1e-9:
        return None
    return LinkAxis(body, anchor, (tip - anchor) / length, length)


def _welded_frames(model: mujoco.MjModel, body: int) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Position and rotation matrix, in the frame of a body, of it and of the bodies welded to it."""
    frames = {body: (np.zeros(3), np.eye(3))}
    for child in range(body + 1, model.nbody):
        parent = int(model.body_parentid[child])
        if parent in frames and not model.body_jntnum[child]:
            origin, turn = frames[parent]
            frames[child] = (origin + turn @ model.body_pos[child], turn @ rotation_matrix(model.body_quat[child]))
    return frames


def _geom_points(
    model: mujoco.MjModel, frames: dict[int, tuple[np.ndarray, np.ndarray]], geoms: list[int] | None
) -> list[np.ndarray]:
    """Centres of geoms and ends of elongated ones, in the frame of the first body."""
    points = []
    for body, (origin, turn) in frames.items():
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
            if geoms is not None and geom not in geoms:
                continue
            centre = model.geom_pos[geom]
            ends = [centre]
            for axis in np.eye(3):
                found = long_axis(model, geom, rotation_matrix(model.geom_quat[geom]) @ axis)
                if found is not None:
                    reach = found[1] * axis_vector(model, geom, found[0])
                    ends += [centre + reach, centre - reach]
            points += [origin + turn @ end for end in ends]
    return points


def lengthen(model: mujoco.MjModel, link: LinkAxis, change: float) -> None:
    """Change the length of a link in place.

    Points of the body move along the axis in proportion to their distance from the joint, by the full change at the
    far end and beyond: child bodies, sites, centres of geoms, and both ends of geoms that are elongated along the axis.
    The mass of elongated geoms grows at constant density. If the inertia of the body is not that of its elongated
    geoms, its mass distribution is stretched along the axis instead.

    Args:
      model: edited in place.
      link: the axis before the change.
      change: increase of the length [m].
    """
    body = link.body

    def moved(point: np.ndarray) -> np.ndarray:
        share = np.clip((point - link.anchor) @ link.direction / link.length, 0.0, 1.0)
        return point + change * share * link.direction

    before = MassProperties.of(model, body)
    own = np.flatnonzero(model.geom_bodyid == body).tolist()
    long = [g for g in own if long_axis(model, g, link.direction) is not None]
    solid = geoms_at_density(model, long, 1.0)
    for child in np.flatnonzero(model.body_parentid == body):
        if child != body:
            model.body_pos[child] = moved(model.body_pos[child])
    for site in np.flatnonzero(model.site_bodyid == body):
        model.site_pos[site] = moved(model.site_pos[site])
    for geom in own:
        _move_geom(model, geom, link, moved)
    density = before.mass / solid.mass if solid.mass > 0 else 0.0
    if solid.mass > 0 and _same(before, solid, density):
        geoms_at_density(model, long, density).write(model, body)
        return
    grown = geoms_at_density(model, long, 1.0).mass / solid.mass if solid.mass > 0 else 1.0
    stretch = np.eye(3) + change / link.length * np.outer(link.direction, link.direction)
    second = 0.5 * np.trace(before.inertia) * np.eye(3) - before.inertia  # second moment about the centre
    second = grown * stretch @ second @ stretch
    inertia = np.trace(second) * np.eye(3) - second
    centre = link.anchor + stretch @ (before.centre - link.anchor)
    MassProperties(grown * before.mass, centre, inertia).write(model, body)


def _same(body: MassProperties, solid: MassProperties, density: float) -> bool:
    """Whether the mass properties of a body are those of solid geoms of uniform density."""
    size = float(np.abs(body.inertia).max())
    return bool(
        np.allclose(body.centre, solid.centre, atol=1e-6 * (1 + np.abs(solid.centre).max()))
        and np.allclose(body.inertia, density * solid.inertia, atol=1e-5 * size)
    )


def _move_geom(model: mujoco.MjModel, geom: int, link: LinkAxis, moved: Callable[[np.ndarray], np.ndarray]) -> None:
    """Move a geom; if it is elongated along the link, move both of its ends."""
    found = long_axis(model, geom, link.direction)
    if found is None:
        model.geom_pos[geom] = moved(model.geom_pos[geom])
        clear_sameframe(model, int(model.geom_bodyid[geom]))
        return
    axis, half = found
    old = axis_vector(model, geom, axis)
    ends = [moved(model.geom_pos[geom] + sign * half * old) for sign in (1.0, -1.0)]
    model.geom_pos[geom] = 0.5 * (ends[0] + ends[1])
    new = ends[0] - ends[1]
    model.geom_size[geom, axis] = 0.5 * np.linalg.norm(new)
    unit = new / np.linalg.norm(new)
    turn, quaternion = np.r_[1 + old @ unit, np.cross(old, unit)], np.zeros(4)  # the shortest one
    mujoco.mju_mulQuat(quaternion, turn / np.linalg.norm(turn), model.geom_quat[geom].copy())
    model.geom_quat[geom] = quaternion
    grown = model.geom_size[geom, axis] - half
    # The bounding box is (centre, half sizes) in the geom's frame.
    box_axis = 2 if axis == 1 and int(model.geom_type[geom]) in _TUBES else axis
    model.geom_aabb[geom, 3 + box_axis] += grown
    model.geom_rbound[geom] = _bound(model, geom)
    clear_sameframe(model, int(model.geom_bodyid[geom]))


_TUBES = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))


def _bound(model: mujoco.MjModel, geom: int) -> float:
    """Radius of the bounding sphere of an elongated geom."""
    kind, (a, b, c) = int(model.geom_type[geom]), (float(x) for x in model.geom_size[geom])
    if kind == int(mujoco.mjtGeom.mjGEOM_CAPSULE):
        return a + b
    if kind == int(mujoco.mjtGeom.mjGEOM_CYLINDER):
        return float(np.hypot(a, b))
    if kind == int(mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        return max(a, b, c)
    return float(np.linalg.norm([a, b, c]))
