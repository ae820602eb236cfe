"""Contact forces at one point: frictionless, pyramidal and elliptic friction cones (mj_constraintUpdate).

A contact force depends on the acceleration of the contact point only. Within one zone of the cone (separated, sticking,
sliding, ...) it is linear in that acceleration: a 3x3 stiffness and a force, both exact for the zone. The contact
Jacobian is never formed.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from btr_mjx.engines.lanes.scalars import (
    Matrix,
    Scalar,
    Symmetric,
    Vector,
    add,
    cross,
    full,
    matvec,
    mul,
    sandwich,
    sub,
    transpose,
    vadd,
    vsub,
)
from btr_mjx.engines.lanes.spatial import Block, Spatial, point_block
from btr_mjx.engines.lanes.tree import Link

type ZoneModel = tuple[jax.Array, ...]
"""Coefficients that identify the zone of a constraint and determine its force, see `Cone.linear`."""


def impedance(parameters: Sequence[Scalar], depth: Scalar) -> Scalar:
    """MuJoCo's impedance d(r) in (0, 1) at violation `depth` = |r| (getimpedance).

    Args:
      parameters: dmin, dmax, width, midpoint, power.
      depth: distance beyond the margin [m or rad], any sign.

    Returns:
      The impedance, dimensionless.
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
class Cone(ABC):
    """The force law of contact points, one for each element; inactive in worlds where `weight` is zero."""

    frame: Matrix
    """Rows: normal and two tangents."""
    friction: Scalar
    weight: Scalar
    """Inverse regularisation D of each row [kg]; of the normal row for an elliptic cone."""
    reference: Vector
    """Reference acceleration along the rows of the frame [m/s^2]."""

    flags: ClassVar[int] = 0
    """Number of coefficients of a zone if each is either the weight or zero (they can be stored as bools); else 0."""
    quadratic: ClassVar[bool] = True
    """Whether the cost is quadratic within a zone."""

    @abstractmethod
    def model(self, a: Vector) -> ZoneModel:
        """Zone of the cone at contact-frame acceleration `a`."""

    @abstractmethod
    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """Stiffness and force of a zone in the contact frame: at `a` the contact force is force - stiffness a."""

    def same_zone(self, old: ZoneModel, new: ZoneModel) -> jax.Array:
        """Whether two zones are the same."""
        return reduce(jnp.logical_and, [x == y for x, y in zip(old, new, strict=True)])


class Frictionless(Cone):
    """A contact with a normal row only."""

    flags: ClassVar[int] = 1

    def model(self, a: Vector) -> ZoneModel:
        """Weight of the normal row if it is active, else zero."""
        return (jnp.where(sub(a[0], self.reference[0]) < 0, self.weight, 0),)

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Cone.linear`."""
        return [model[0], 0.0, 0.0, 0.0, 0.0, 0.0], [mul(model[0], self.reference[0]), 0.0, 0.0]


@dataclass
class Pyramid(Cone):
    """A contact with the four edges of a friction pyramid."""

    flags: ClassVar[int] = 4

    def __post_init__(self) -> None:
        self._references = self._edges(self.reference)  # once, not in every iteration

    def _edges(self, a: Vector) -> list[Scalar]:
        """Components along the four edges."""
        p, q = mul(self.friction, a[1]), mul(self.friction, a[2])
        return [add(a[0], p), sub(a[0], p), add(a[0], q), sub(a[0], q)]

    def model(self, a: Vector) -> ZoneModel:
        """Weights of the active edges, zero for the others."""
        edges = zip(self._edges(a), self._references, strict=True)
        return tuple(jnp.where(sub(edge, reference) < 0, self.weight, 0) for edge, reference in edges)

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Cone.linear`."""
        mu, (w0, w1, w2, w3) = self.friction, model
        pair1, pair2, skew1, skew2 = add(w0, w1), add(w2, w3), mul(mu, sub(w0, w1)), mul(mu, sub(w2, w3))
        square = mul(mu, mu)
        stiffness = [add(pair1, pair2), mul(square, pair1), mul(square, pair2), skew1, skew2, 0.0]
        return stiffness, matvec(full(stiffness), self.reference)


@dataclass
class Ellipse(Cone):
    """A contact with an elliptic cone (mj_constraintUpdate); in the sliding zone the cost is not quadratic."""

    impratio: Scalar
    tolerance: float
    """Relative change of stiffness and force below which two zones count as equal."""

    quadratic: ClassVar[bool] = False

    def model(self, a: Vector) -> ZoneModel:
        """Stiffness (six coefficients) and force (three), linearised at `a`."""
        mu, ratio = self.friction, jnp.sqrt(jnp.asarray(self.impratio, self.weight.dtype))
        cone = mu / ratio  # slope of the regularised cone
        jar = vsub(a, self.reference)
        n, u, w = mul(jar[0], cone), mul(jar[1], mu), mul(jar[2], mu)
        square = add(mul(u, u), mul(w, w))
        slides = square > 0
        t = jnp.sqrt(jnp.where(slides, square, 1.0)) * slides
        separated = (n >= cone * t) & (slides | (n >= 0))
        sticks = (cone * n + t <= 0) & (slides | (n < 0))
        # Sliding: cost 1/2 strength (n - cone t)^2.
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
        return tuple(jnp.where(separated, 0, jnp.where(sticks, x, y)) for x, y in pairs)

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Cone.linear`."""
        return model[:6], model[6:]

    def same_zone(self, old: ZoneModel, new: ZoneModel) -> jax.Array:
        """Whether two linearisations agree to the tolerance."""
        same = []
        for part in (slice(0, 6), slice(6, 9)):
            size = reduce(jnp.maximum, [jnp.abs(x) for x in new[part]])
            change = reduce(jnp.maximum, [jnp.abs(x - y) for x, y in zip(old[part], new[part], strict=True)])
            same.append(~(change > self.tolerance * size))
        return same[0] & same[1]


@dataclass
class Contact:
    """One contact point of one link with the world."""

    link: Link
    x: Vector
    """Contact point relative to the link's origin, world axes [m]."""
    cone: Cone

    def acceleration(self, spatial: Spatial) -> list[Scalar]:
        """Contact-frame acceleration of the point from the spatial acceleration of its link."""
        linear, angular = spatial
        return matvec(self.cone.frame, vadd(linear, cross(angular, self.x)))

    def effect(self, model: ZoneModel) -> tuple[Block, Spatial]:
        """Stiffness block and wrench about the link's origin for a zone."""
        stiffness, force = self.cone.linear(model)
        across = transpose(self.cone.frame)
        f = matvec(across, force)
        return point_block(sandwich(across, stiffness), self.x), (f, cross(self.x, f))


def make_cone(
    condim: int,
    frame: Matrix,
    friction: Scalar,
    weight: Scalar,
    reference: Vector,
    impratio: Scalar | None,
    dtype: Any,
) -> Cone:
    """The force law of contact points of condim 1 or 3.

    Args:
      condim: 1 for a normal force only.
      frame: rows: normal and two tangents.
      friction: coefficient of both tangents.
      weight: inverse regularisation of each row; zero where inactive.
      reference: reference acceleration along the rows of the frame.
      impratio: MuJoCo's option, for an elliptic cone; None for a pyramidal one.
      dtype: of the computation.
    """
    numbers = (frame, friction, weight, reference)
    if condim == 1:
        return Frictionless(*numbers)
    if impratio is None:
        return Pyramid(*numbers)
    return Ellipse(*numbers, impratio, float(np.sqrt(np.finfo(dtype).eps)))
