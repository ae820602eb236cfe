"""Contacts of spheres, capsules and boxes with planes of the world.

A contact acts at one point of one link. What the solver needs from it is linear in the acceleration of that point: a
3x3 stiffness and a force, both exact for the cone's present zone. The contact Jacobian never appears.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from btr_mjx.engines.lanes import support
from btr_mjx.engines.lanes.kinematics import Motion, point_velocity
from btr_mjx.engines.lanes.parameters import Parameters
from btr_mjx.engines.lanes.scalars import (
    Matrix,
    Scalar,
    Symmetric,
    Vector,
    add,
    array,
    cross,
    dot,
    full,
    is_zero,
    matvec,
    mul,
    neg,
    sandwich,
    scale,
    sub,
    total,
    transpose,
    vadd,
    vsub,
)
from btr_mjx.engines.lanes.spatial import Block, Spatial, point_block
from btr_mjx.engines.lanes.tree import Link, Touch, TreePlan

type ZoneModel = tuple[jax.Array, ...]
"""The zone that a constraint is in, as the numbers that its force is linear in."""


def impedance(parameters: Sequence[Scalar], depth: Scalar) -> Scalar:
    """MuJoCo's impedance d(r) in (0, 1) at violation `depth` = |r| (getimpedance).

    Args:
      parameters: dmin, dmax, width, midpoint, power.
      depth: distance beyond the margin, any sign.
    """
    low, high, width, middle, power = parameters
    x = jnp.minimum(jnp.abs(mul(_inverse(width), depth)), 1.0)
    rest = sub(1.0, x)
    shape = power if isinstance(power, float) else None
    if shape == 1.0:
        y = x
    elif shape == 2.0:
        upper = sub(1.0, mul(_inverse(sub(1.0, middle)), mul(rest, rest)))
        y = jnp.where(_below(x, middle), mul(_inverse(middle), mul(x, x)), upper)
    else:
        ones = jnp.ones_like(x)
        middle, power = mul(middle, ones), mul(power, ones)
        upper = sub(1.0, (1.0 - middle) * (rest / (1.0 - middle)) ** power)
        y = jnp.where(x <= middle, middle * (x / middle) ** power, upper)
    return add(low, mul(y, sub(high, low)))


def _inverse(a: Scalar) -> Scalar:
    return 1.0 / a


def _below(x: jax.Array, limit: Scalar) -> jax.Array:
    return sub(x, limit) <= 0


@dataclass
class Contact(ABC):
    """One contact point of one link; inactive where `weight` is zero."""

    link: Link
    x: Vector
    """Contact point relative to the link's origin, world axes [m]."""
    frame: Matrix
    """Rows: normal and two tangents."""
    friction: Scalar
    weight: Scalar
    """Inverse regularisation D of each row [kg]; of the normal row for an elliptic cone."""
    reference: Vector
    """Reference acceleration along the rows of the frame [m/s^2]."""

    flags: ClassVar[int] = 0
    """Numbers of a zone that are either the weight or zero, where that is all there is to it; else 0."""

    @abstractmethod
    def model(self, a: Vector) -> ZoneModel:
        """The zone of the cone that contact-frame acceleration `a` lies in, as the numbers that `linear` needs."""

    @abstractmethod
    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """Stiffness and force in the contact frame for a zone: at `a` the contact pushes with force - stiffness a."""

    def settled(self, old: ZoneModel, new: ZoneModel) -> jax.Array:
        """Whether two zones are the same."""
        return reduce(jnp.logical_and, [x == y for x, y in zip(old, new, strict=True)])

    def acceleration(self, spatial: Spatial) -> list[Scalar]:
        """Contact-frame acceleration of the point from the spatial acceleration of its link."""
        linear, angular = spatial
        return matvec(self.frame, vadd(linear, cross(angular, self.x)))

    def effect(self, model: ZoneModel) -> tuple[Block, Spatial]:
        """Stiffness block and wrench about the link's origin for a zone."""
        stiffness, force = self.linear(model)
        across = transpose(self.frame)
        f = matvec(across, force)
        return point_block(sandwich(across, stiffness), self.x), (f, cross(self.x, f))


class Frictionless(Contact):
    """A contact with a normal row only."""

    flags: ClassVar[int] = 1

    def model(self, a: Vector) -> ZoneModel:
        """Weight of the row if it pushes."""
        return (jnp.where(sub(a[0], self.reference[0]) < 0, self.weight, 0),)

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Contact.linear`."""
        return [model[0], 0.0, 0.0, 0.0, 0.0, 0.0], [mul(model[0], self.reference[0]), 0.0, 0.0]


@dataclass
class Pyramid(Contact):
    """A contact with the four edges of a friction pyramid."""

    flags: ClassVar[int] = 4

    def __post_init__(self) -> None:
        self._references = self._edges(self.reference)  # once, not in every iteration

    def _edges(self, a: Vector) -> list[Scalar]:
        """Components along the four edges."""
        p, q = mul(self.friction, a[1]), mul(self.friction, a[2])
        return [add(a[0], p), sub(a[0], p), add(a[0], q), sub(a[0], q)]

    def model(self, a: Vector) -> ZoneModel:
        """Weights of the edges that push."""
        edges = zip(self._edges(a), self._references, strict=True)
        return tuple(jnp.where(sub(edge, reference) < 0, self.weight, 0) for edge, reference in edges)

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Contact.linear`."""
        mu, (w0, w1, w2, w3) = self.friction, model
        pair1, pair2, skew1, skew2 = add(w0, w1), add(w2, w3), mul(mu, sub(w0, w1)), mul(mu, sub(w2, w3))
        square = mul(mu, mu)
        stiffness = [add(pair1, pair2), mul(square, pair1), mul(square, pair2), skew1, skew2, 0.0]
        return stiffness, matvec(full(stiffness), self.reference)


@dataclass
class Ellipse(Contact):
    """A contact with an elliptic cone (mj_constraintUpdate): between its zones the cost is not quadratic."""

    impratio: Scalar
    tolerance: float
    """Relative change of stiffness and force below which two models are the same."""

    def model(self, a: Vector) -> ZoneModel:
        """Stiffness (six numbers) and force (three)."""
        mu, ratio = self.friction, jnp.sqrt(jnp.asarray(self.impratio, a[0].dtype))
        cone = mu / ratio  # slope of the regularised cone
        jar = vsub(a, self.reference)
        n, u, w = mul(jar[0], cone), mul(jar[1], mu), mul(jar[2], mu)
        square = add(mul(u, u), mul(w, w))
        slides = square > 0
        t = jnp.sqrt(jnp.where(slides, square, 1.0)) * slides
        free = (n >= cone * t) & (slides | (n >= 0))
        sticks = (cone * n + t <= 0) & (slides | (n < 0))
        # Sliding: the cost is 1/2 strength (n - cone t)^2.
        strength = self.weight / (cone * cone * (1.0 + cone * cone))
        inverse = 1.0 / jnp.where(slides, t, 1.0)
        gap = n - cone * t
        push = -strength * gap * cone
        e1, e2 = u * inverse, w * inverse  # direction of sliding
        bend = cone * n * inverse
        side = strength * mu * mu
        hessian = [
            strength * cone * cone,
            side * (bend * e1 * e1 + cone * cone - bend),
            side * (bend * e2 * e2 + cone * cone - bend),
            -strength * cone * mu * cone * e1,
            -strength * cone * mu * cone * e2,
            side * bend * e1 * e2,
        ]
        slide_force = vadd([push, -push * e1 * mu, -push * e2 * mu], matvec(full(hessian), a))
        across = self.weight * (ratio * ratio)
        stick = [self.weight, across, across, 0.0, 0.0, 0.0]
        stick_force = matvec(full(stick), self.reference)
        pairs = zip([*stick, *stick_force], [*hessian, *slide_force], strict=True)
        return tuple(jnp.where(free, 0, jnp.where(sticks, x, y)) for x, y in pairs)

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Contact.linear`."""
        return model[:6], model[6:]

    def settled(self, old: ZoneModel, new: ZoneModel) -> jax.Array:
        """Whether two models agree to the tolerance."""
        same = []
        for part in (slice(0, 6), slice(6, 9)):
            size = reduce(jnp.maximum, [jnp.abs(x) for x in new[part]])
            change = reduce(jnp.maximum, [jnp.abs(x - y) for x, y in zip(old[part], new[part], strict=True)])
            same.append(~(change > self.tolerance * size))
        return same[0] & same[1]


def _points(parameters: Parameters, key: str, touch: Touch, m: Motion) -> list[tuple[list[Scalar], Any]]:
    """Points whose spheres of the geom's radius may touch: offset from the link's origin, offset from the centre."""
    centre = matvec(m.turn, parameters[f"{key}/centre"])
    if touch.kind == support.SPHERE:
        return [(centre, None)]
    if touch.kind == support.CAPSULE:
        segment = scale(parameters.one(f"{key}/half"), matvec(m.turn, parameters[f"{key}/axis"]))
        return [(vadd(centre, segment), None), (vsub(centre, segment), None)]
    edges = [matvec(m.turn, row) for row in parameters.matrix(f"{key}/edges")]
    corners = []
    for signs in product((-1.0, 1.0), repeat=3):
        corner = [total(mul(sign, edge[i]) for sign, edge in zip(signs, edges, strict=True)) for i in range(3)]
        corners.append((vadd(centre, corner), corner))
    return corners


def _contact_frame(parameters: Parameters, key: str, touch: Touch, m: Motion) -> Matrix:
    """The plane's contact frame, its first tangent turned to a capsule's axis (mjc_PlaneCapsule)."""
    frame = parameters.matrix(f"plane{touch.plane}/frame")
    if touch.kind != support.CAPSULE:
        return frame
    normal, axis = frame[0], matvec(m.turn, parameters[f"{key}/axis"])
    tangent = vsub(axis, scale(dot(normal, axis), normal))
    square = dot(tangent, tangent)
    upright = square < 1e-30  # no direction to follow: MuJoCo takes the first axis
    inverse = jax.lax.rsqrt(jnp.where(upright, 1.0, square))
    tangent = [jnp.where(upright, unit, mul(inverse, t)) for unit, t in zip((1.0, 0.0, 0.0), tangent, strict=True)]
    return [normal, tangent, cross(normal, tangent)]


@dataclass(frozen=True)
class _GeomOverPlane:
    """A geom of a link and the plane that it may touch, at the link's present place."""

    key: str
    """Of the geom's numbers among the parameters."""
    link: Link
    touch: Touch
    motion: Motion
    """Of the link."""
    frame: Matrix
    """Axes of the contact, the normal first."""
    base: Scalar
    """Height of the link's origin over the plane [m]."""


def contact_points(
    plan: TreePlan, parameters: Parameters, motions: Sequence[Motion], elliptic: bool, dtype: Any
) -> list[Contact]:
    """All contact points of a chunk that could be active, with MuJoCo's reference accelerations and weights."""
    found = []
    for link, m in zip(plan.links, motions, strict=True):
        for n, touch in enumerate(link.touches):
            key = f"{link.index}/touch{n}"
            frame = _contact_frame(parameters, key, touch, m)
            base = sub(dot(frame[0], m.position), parameters.one(f"plane{touch.plane}/offset"))
            geom = _GeomOverPlane(key, link, touch, m, frame, base)
            for offset, corner in _points(parameters, key, touch, m):
                found.append(_contact(parameters, geom, offset, corner, elliptic, dtype))
    return found


def _contact(
    parameters: Parameters,
    geom: _GeomOverPlane,
    offset: Vector,
    corner: Vector | None,
    elliptic: bool,
    dtype: Any,
) -> Contact:
    """One point of a geom; `offset` leads there from the link's origin."""
    key, frame = geom.key, geom.frame
    radius = parameters.one(f"{key}/radius")
    distance = sub(add(geom.base, dot(frame[0], offset)), radius)
    beyond = sub(distance, parameters.one(f"{key}/margin"))
    active = beyond < 0
    if corner is not None:
        active = active & (dot(frame[0], corner) <= 0)  # a box touches with its lower corners only
    x = vsub(offset, scale(add(radius, mul(0.5, distance)), frame[0]))
    imp = impedance(parameters[f"{key}/impedance"], beyond)
    strength = mul(parameters.one(f"{key}/scale"), imp / (1.0 - imp))
    stiffness, damping = parameters[f"{key}/reference"]
    velocity = matvec(frame, point_velocity(geom.motion, x))
    reference = scale(neg(damping), velocity)
    reference[0] = sub(reference[0], mul(mul(stiffness, imp), beyond))
    weight = jnp.where(active, strength, 0)
    if is_zero(weight):
        weight = array(weight, beyond.shape, dtype)
    numbers = (geom.link, x, frame, parameters.one(f"{key}/friction"), weight, reference)
    if geom.touch.condim == 1:
        return Frictionless(*numbers)
    if not elliptic:
        return Pyramid(*numbers)
    tolerance = float(np.sqrt(np.finfo(dtype).eps))
    return Ellipse(*numbers, parameters.one("world/impratio"), tolerance)
