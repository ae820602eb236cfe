"""Contact points of spheres, capsules, boxes, cylinders and ellipsoids with fixed planes.

Source: google-deepmind/mujoco, mjc_PlaneSphere, mjc_PlaneCapsule, mjc_PlaneBox, mjc_PlaneCylinder; impedance and
reference acceleration as in mj_makeImpedance and mj_referenceConstraint.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from btr_mjx.engines.lanes_engine import support
from btr_mjx.engines.lanes_engine.constraints.cones import impedance
from btr_mjx.engines.lanes_engine.constraints.friction_cones import make_cone
from btr_mjx.engines.lanes_engine.constraints.points import Contact
from btr_mjx.engines.lanes_engine.kinematics import Motion, point_velocity
from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.tree import Link, Touch, TreePlan
from btr_mjx.engines.scalars import (
    Matrix,
    Scalar,
    Vector,
    add,
    array,
    cross,
    dot,
    is_zero,
    matvec,
    mul,
    neg,
    scale,
    sub,
    total,
    transpose,
    vadd,
    vsub,
)


def _points(parameters: Parameters, key: str, touch: Touch, m: Motion) -> list[tuple[list[Scalar], Any]]:
    """Candidate points: offset from the link's origin, and in which worlds they can touch; None for all."""
    centre = matvec(m.rotation, parameters[f"{key}/centre"])
    if touch.kind == support.SPHERE:
        return [(centre, None)]
    if touch.kind == support.CAPSULE:
        segment = scale(parameters.one(f"{key}/half"), matvec(m.rotation, parameters[f"{key}/axis"]))
        return [(vadd(centre, segment), None), (vsub(centre, segment), None)]
    normal = parameters.matrix(f"plane{touch.plane}/frame")[0]
    if touch.kind == support.CYLINDER:
        return [(vadd(centre, point), None) for point in _rim_points(parameters, key, normal, m)]
    edges = [matvec(m.rotation, row) for row in parameters.matrix(f"{key}/edges")]
    if touch.kind == support.ELLIPSOID:
        along = [dot(edge, normal) for edge in edges]
        inverse = jax.lax.rsqrt(dot(along, along))
        lowest = [mul(inverse, dot(along, row)) for row in transpose(edges)]
        return [(vsub(centre, lowest), None)]
    corners = []
    for signs in product((-1.0, 1.0), repeat=3):
        corner = [total(mul(sign, edge[i]) for sign, edge in zip(signs, edges, strict=True)) for i in range(3)]
        corners.append((vadd(centre, corner), dot(normal, corner) <= 0))  # only the lower corners can touch
    return corners


def _rim_points(parameters: Parameters, key: str, normal: Vector, m: Motion) -> list[list[Scalar]]:
    """The four points of a cylinder that can touch, from its centre (mjc_PlaneCylinder)."""
    axis, rim = matvec(m.rotation, parameters[f"{key}/axis"]), parameters.one(f"{key}/rim")
    along = dot(normal, axis)
    turn = jnp.where(along > 0, -1.0, 1.0)  # the axis points to the plane
    axis, along = scale(turn, axis), mul(turn, along)
    down = vsub(scale(along, axis), normal)
    square = dot(down, down)
    upright = square < 1e-30  # the rim is parallel to the plane: MuJoCo uses the x axis of the cylinder
    inverse = jax.lax.rsqrt(jnp.where(upright, 1.0, square))
    side = matvec(m.rotation, parameters[f"{key}/side"])
    down = [mul(rim, jnp.where(upright, s, mul(inverse, x))) for s, x in zip(side, down, strict=True)]
    across = scale(0.5 * np.sqrt(3.0), cross(down, axis))  # |down| is the radius, and it is normal to the axis
    axis = scale(parameters.one(f"{key}/half"), axis)
    far = vsub(axis, scale(0.5, down))
    return [vadd(down, axis), vsub(down, axis), vadd(far, across), vsub(far, across)]


def _contact_frame(parameters: Parameters, key: str, touch: Touch, m: Motion, elliptic: bool) -> Matrix:
    """The plane's contact frame; for a capsule its first tangent follows the axis (mjc_PlaneCapsule).

    The direction of the tangents makes no difference to elliptic cones.
    """
    frame = parameters.matrix(f"plane{touch.plane}/frame")
    if touch.kind != support.CAPSULE or elliptic:
        return frame
    normal, axis = frame[0], matvec(m.rotation, parameters[f"{key}/axis"])
    tangent = vsub(axis, scale(dot(normal, axis), normal))
    square = dot(tangent, tangent)
    upright = square < 1e-30  # tangent undefined: MuJoCo uses the x axis
    inverse = jax.lax.rsqrt(jnp.where(upright, 1.0, square))
    tangent = [jnp.where(upright, unit, mul(inverse, t)) for unit, t in zip((1.0, 0.0, 0.0), tangent, strict=True)]
    return [normal, tangent, cross(normal, tangent)]


@dataclass(frozen=True)
class _GeomOverPlane:
    """A geom of a link and the plane that it may touch, in the present configuration."""

    key: str
    """Prefix of the geom's names in `Parameters`."""
    link: Link
    touch: Touch
    motion: Motion
    """Of the link."""
    frame: Matrix
    """Axes of the contact, the normal first."""
    base: Scalar
    """Height of the link's origin over the plane [m]."""


def contact_points(
    plan: TreePlan,
    parameters: Parameters,
    motions: Sequence[Motion],
    elliptic: bool,
    dtype: Any,
) -> list[Contact]:
    """All candidate contact points, with MuJoCo's reference accelerations; inactive ones have weight zero."""
    found = []
    for link, m in zip(plan.links, motions, strict=True):
        for n, touch in enumerate(link.touches):
            key = f"{link.index}/touch{n}"
            frame = _contact_frame(parameters, key, touch, m, elliptic)
            base = sub(dot(frame[0], m.position), parameters.one(f"plane{touch.plane}/offset"))
            geom = _GeomOverPlane(key, link, touch, m, frame, base)
            for offset, possible in _points(parameters, key, touch, m):
                found.append(_contact(parameters, geom, offset, possible, elliptic, dtype))
    return found


def _contact(
    parameters: Parameters,
    geom: _GeomOverPlane,
    offset: Vector,
    possible: jax.Array | None,
    elliptic: bool,
    dtype: Any,
) -> Contact:
    """Contact at one point of a geom, at `offset` from the link's origin."""
    key, frame = geom.key, geom.frame
    radius = parameters.one(f"{key}/radius")
    distance = sub(add(geom.base, dot(frame[0], offset)), radius)
    beyond = sub(distance, parameters.one(f"{key}/margin"))
    active = beyond < 0
    if possible is not None:
        active = active & possible
    x = vsub(offset, scale(add(radius, mul(0.5, distance)), frame[0]))
    imp = impedance(parameters[f"{key}/impedance"], beyond)
    strength = mul(parameters.one(f"{key}/scale"), imp / (1.0 - imp))
    stiffness, damping = parameters[f"{key}/reference"]
    velocity = matvec(frame, point_velocity(geom.motion, x))
    velocity += matvec(frame[: max(0, geom.touch.condim - 3)], geom.motion.angular_velocity)
    reference = scale(neg(damping), velocity)
    reference[0] = sub(reference[0], mul(mul(stiffness, imp), beyond))
    weight = jnp.where(active, strength, 0)
    if is_zero(weight):
        weight = array(weight, beyond.shape, dtype)
    impratio = parameters.one("world/impratio") if elliptic else None
    cone = make_cone(geom.touch.condim, frame, parameters[f"{key}/friction"], weight, reference, impratio, dtype)
    return Contact(geom.link, x, cone)
