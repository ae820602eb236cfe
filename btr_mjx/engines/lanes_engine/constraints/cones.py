"""Contact forces at one point: frictionless, pyramidal and elliptic friction cones (mj_constraintUpdate).

A contact force depends on the acceleration of the contact point only. Within one zone of the cone (separated, sticking,
sliding, ...) it is linear in that acceleration: a stiffness and a force, both exact for the zone. The contact
Jacobian is never formed.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations, combinations_with_replacement
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.spatial import Block, Spatial, point_block
from btr_mjx.engines.lanes_engine.tree import Link
from btr_mjx.engines.scalars import (
    SIX,
    Matrix,
    Scalar,
    Symmetric,
    Vector,
    add,
    cross,
    dot,
    full,
    matmul,
    matvec,
    mul,
    neg,
    padded,
    sandwich,
    scale,
    sub,
    total,
    transpose,
    vadd,
    vsub,
)

type ZoneModel = tuple[jax.Array, ...]
"""Coefficients that identify the zone of a constraint and determine its force, see `Cone.linear`."""


def impedance(parameters: Sequence[Scalar], depth: Scalar) -> Scalar:
    """MuJoCo's impedance d(r) in (0, 1) at a distance beyond the margin [m or rad], of any sign (getimpedance).

    Its parameters are dmin, dmax, width, midpoint and power.
    """
    low, high, width, middle, power = parameters
    x = jnp.minimum(jnp.abs(mul(1.0 / width, depth)), 1.0)
    rest = sub(1.0, x)
    if isinstance(power, float) and power == 1.0:
        y = x
    elif isinstance(power, float) and power == 2.0:
        upper = sub(1.0, mul(1.0 / sub(1.0, middle), mul(rest, rest)))
        y = jnp.where(sub(x, middle) <= 0, mul(1.0 / middle, mul(x, x)), upper)
    else:
        ones = jnp.ones_like(x)
        middle, power = mul(middle, ones), mul(power, ones)
        upper = sub(1.0, (1.0 - middle) * (rest / (1.0 - middle)) ** power)
        y = jnp.where(x <= middle, middle * (x / middle) ** power, upper)
    return add(low, mul(y, sub(high, low)))


def constraint_law(parameters: Parameters, prefix: str, beyond: Scalar, speed: Scalar) -> tuple[Scalar, Scalar]:
    """Weight and reference acceleration of a row at a violation and its rate (mj_makeImpedance)."""
    imp = impedance(parameters[f"{prefix}impedance"], beyond)
    stiffness, damping = parameters[f"{prefix}reference"]
    weight = mul(parameters.one(f"{prefix}scale"), imp / (1.0 - imp))
    return weight, sub(mul(neg(damping), speed), mul(mul(stiffness, imp), beyond))


_KINDS = (0, 0, 1, 2, 2)
"""Friction of each row but the first: sliding along two tangents, spinning, rolling about both tangents."""


@dataclass
class Cone(ABC):
    """The force law of contact points, one for each element; inactive in worlds where `weight` is zero.

    Rows are the normal, and as far as the contact has them two tangents, the rotation about the normal, and those about
    the tangents.
    """

    frame: Matrix
    """Rows: normal and two tangents."""
    friction: Vector
    """Coefficients of sliding, of spinning [m] and of rolling [m], as far as the contact has them."""
    weight: Scalar
    """Inverse regularisation D of each row [kg]; of the normal row for an elliptic cone."""
    reference: Vector
    """Reference acceleration along the rows [m/s^2 or rad/s^2]."""

    quadratic: ClassVar[bool] = True
    """Whether the cost is quadratic within a zone."""

    @property
    def flags(self) -> int:
        """Number of coefficients of a zone if each is the weight or zero (they can be stored as bools); else 0."""
        return 0

    @abstractmethod
    def model(self, a: Vector) -> ZoneModel:
        """Zone of the cone at acceleration `a` along the rows."""

    @abstractmethod
    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """Stiffness and force of a zone along the rows: at `a` the contact force is force - stiffness a."""

    def slopes(self, start: Vector, along: Vector) -> Callable[[Scalar], tuple[Scalar, Scalar]]:
        """First and second derivative of the cost by the length of a step from `start` along the rows."""

        def at(length: Scalar) -> tuple[Scalar, Scalar]:
            here = vadd(start, scale(length, along))
            stiffness, force = self.linear(self.model(here))
            bent = matvec(full(stiffness), along)
            return sub(dot(bent, here), dot(force, along)), dot(bent, along)

        return at

    def same_zone(self, old: ZoneModel, new: ZoneModel) -> jax.Array:
        """Whether two zones are the same."""
        return reduce(jnp.logical_and, [x == y for x, y in zip(old, new, strict=True)])


class Frictionless(Cone):
    """A contact with a normal row only."""

    @property
    def flags(self) -> int:
        """See `Cone.flags`."""
        return 1

    def model(self, a: Vector) -> ZoneModel:
        """Weight of the normal row if it is active, else zero."""
        return (jnp.where(sub(a[0], self.reference[0]) < 0, self.weight, 0),)

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Cone.linear`."""
        return [model[0], 0.0, 0.0, 0.0, 0.0, 0.0], [mul(model[0], self.reference[0]), 0.0, 0.0]


@dataclass
class Pyramid(Cone):
    """A contact with a friction pyramid: two opposite edges for each row but the first."""

    def __post_init__(self) -> None:
        self._references = self._edges(self.reference)  # once, not in every iteration

    @property
    def flags(self) -> int:
        """See `Cone.flags`."""
        return 2 * (len(self.reference) - 1)

    def _edges(self, a: Vector) -> list[Scalar]:
        """Components along the edges."""
        sides = [mul(self.friction[kind], x) for kind, x in zip(_KINDS, a[1:], strict=False)]
        return [edge(a[0], side) for side in sides for edge in (add, sub)]

    def model(self, a: Vector) -> ZoneModel:
        """Weights of the active edges, zero for the others."""
        edges = zip(self._edges(a), self._references, strict=True)
        return tuple(jnp.where(sub(edge, reference) < 0, self.weight, 0) for edge, reference in edges)

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Cone.linear`."""
        edges = list(zip(model[::2], model[1::2], strict=True))
        pairs = [add(one, other) for one, other in edges]
        skews = [mul(self.friction[kind], sub(*edge)) for kind, edge in zip(_KINDS, edges, strict=False)]
        squares = [mul(mu, mu) for mu in self.friction]
        diagonal = [total(pairs), *(mul(squares[kind], pair) for kind, pair in zip(_KINDS, pairs, strict=False))]
        n = len(diagonal)
        stiffness = padded([*diagonal, *skews], n * (n + 1) // 2)
        return stiffness, matvec(full(stiffness), self.reference)


@dataclass
class Ellipse(Cone):
    """A contact with an elliptic cone (mj_constraintUpdate); in the sliding zone the cost is not quadratic."""

    impratio: Scalar
    tolerance: float
    """Relative change of stiffness and force below which two zones count as equal."""

    quadratic: ClassVar[bool] = False

    def __post_init__(self) -> None:
        ratio = jnp.sqrt(jnp.asarray(self.impratio, self.weight.dtype))
        self._kinds = _KINDS[: len(self.reference) - 1]
        self._slope = self.friction[0] / ratio  # of the regularised cone
        # Sliding: cost 1/2 strength (n - slope t)^2.
        self._strength = self.weight / (self._slope * self._slope * (1.0 + self._slope * self._slope))
        across = [self.weight * (ratio * ratio)]
        across += [across[0] * (other / self.friction[0]) ** 2 for other in self.friction[1:]]
        self._sticking = [self.weight, *(across[kind] for kind in self._kinds)]

    def _scaled_rows(self, x: Vector) -> Vector:
        """Components in which the cone is round."""
        return [mul(x[0], self._slope), *(mul(y, self.friction[k]) for k, y in zip(self._kinds, x[1:], strict=True))]

    def _zone(self, n: Scalar, sides: Vector) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Length of the sides and its inverse (0 and 1 where they vanish); whether the contact is separated, sticks."""
        square = dot(sides, sides)
        slides = square > 0
        t = jnp.sqrt(jnp.where(slides, square, 1.0)) * slides
        separated = (n >= self._slope * t) & (slides | (n >= 0))
        sticks = (self._slope * n + t <= 0) & (slides | (n < 0))
        return t, 1.0 / jnp.where(slides, t, 1.0), separated, sticks

    def model(self, a: Vector) -> ZoneModel:
        """Stiffness and force, linearised at `a`."""
        cone, strength = self._slope, self._strength
        n, *sides = self._scaled_rows(vsub(a, self.reference))
        t, inverse, separated, sticks = self._zone(n, sides)
        gap = n - cone * t
        push = -strength * gap * cone
        along = [x * inverse for x in sides]  # direction of sliding
        bend = cone * n * inverse
        pairs = combinations_with_replacement(range(len(self.friction)), 2)
        side = {(k, m): strength * self.friction[k] * self.friction[m] for k, m in pairs}
        rows = list(zip(self._kinds, along, strict=True))
        hessian = [
            strength * cone * cone,
            *(side[k, k] * (bend * e * e + cone * cone - bend) for k, e in rows),
            *(-strength * cone * self.friction[k] * cone * e for k, e in rows),
            *(side[k, m] * bend * e * f for (k, e), (m, f) in combinations(rows, 2)),
        ]
        pushes = [push, *(-push * e * self.friction[k] for k, e in rows)]
        slide_force = vadd(pushes, matvec(full(hessian), a))
        stick = padded(self._sticking, len(hessian))
        stick_force = matvec(full(stick), self.reference)
        both = zip([*stick, *stick_force], [*hessian, *slide_force], strict=True)
        return tuple(jnp.where(separated, 0, jnp.where(sticks, x, y)) for x, y in both)

    def slopes(self, start: Vector, along: Vector) -> Callable[[Scalar], tuple[Scalar, Scalar]]:
        """See `Cone.slopes`; without the matrices of `linear`, since a search asks for it many times."""
        cone, away = self._slope, vsub(start, self.reference)
        (n0, *sides0), (n1, *sides1) = self._scaled_rows(away), self._scaled_rows(along)
        stiff = [mul(weight, x) for weight, x in zip(self._sticking, along, strict=True)]
        pull, bend, square = dot(stiff, away), dot(stiff, along), dot(sides1, sides1)

        def at(length: Scalar) -> tuple[Scalar, Scalar]:
            n, sides = add(n0, mul(length, n1)), vadd(sides0, scale(length, sides1))
            t, inverse, separated, sticks = self._zone(n, sides)
            speed = dot(sides, sides1) * inverse  # of t
            gap, faster = n - cone * t, n1 - cone * speed
            turning = (square - speed * speed) * inverse
            first = jnp.where(sticks, pull + length * bend, self._strength * gap * faster)
            second = jnp.where(sticks, bend, self._strength * (faster * faster - cone * gap * turning))
            return jnp.where(separated, 0, first), jnp.where(separated, 0, second)

        return at

    def linear(self, model: ZoneModel) -> tuple[Symmetric, Vector]:
        """See `Cone.linear`."""
        forces = len(model) - len(self.reference)
        return model[:forces], model[forces:]

    def same_zone(self, old: ZoneModel, new: ZoneModel) -> jax.Array:
        """Whether two linearisations agree to the tolerance."""
        if len(self.friction) > 1:
            old, new = self._scaled(old), self._scaled(new)
        same = []
        for one, other in zip(self.linear(old), self.linear(new), strict=True):
            size = reduce(jnp.maximum, [jnp.abs(x) for x in other])
            change = reduce(jnp.maximum, [jnp.abs(x - y) for x, y in zip(one, other, strict=True)])
            same.append(~(change > self.tolerance * size))
        return same[0] & same[1]

    def _scaled(self, model: ZoneModel) -> ZoneModel:
        """Coefficients over the friction of their rows: those of rolling are much smaller than those of sliding."""
        inverse = [1.0 / self.friction[kind] for kind in (0, *_KINDS[: len(self.reference) - 1])]
        scales = [x * x for x in inverse] + [x * y for x, y in combinations(inverse, 2)] + inverse
        return tuple(mul(s, x) for s, x in zip(scales, model, strict=True))


@dataclass
class Contact:
    """One contact point of one link with the world."""

    link: Link
    x: Vector
    """Contact point relative to the link's origin, world axes [m]."""
    cone: Cone

    def acceleration(self, spatial: Spatial) -> list[Scalar]:
        """Acceleration along the rows of the cone from the spatial acceleration of its link."""
        linear, angular = spatial
        turning = self.cone.frame[: len(self.cone.reference) - 3]
        return [*matvec(self.cone.frame, vadd(linear, cross(angular, self.x))), *matvec(turning, angular)]

    def effect(self, model: ZoneModel) -> tuple[Block, Spatial]:
        """Stiffness block and wrench about the link's origin for a zone."""
        stiffness, force = self.cone.linear(model)
        across = transpose(self.cone.frame)
        f = matvec(across, force[:3])
        if len(force) == 3:
            return point_block(sandwich(across, stiffness), self.x), (f, cross(self.x, f))
        rows = [padded(row, 6) for row in full(stiffness)]
        rows += [[0.0] * 6] * (6 - len(rows))
        linear, angular = (sandwich(across, [rows[k + i][k + j] for i, j in SIX]) for k in (0, 3))
        mixed = matmul(across, matmul([row[3:] for row in rows[:3]], self.cone.frame))
        torque = vadd(matvec(across, padded(force[3:], 3)), cross(self.x, f))
        return Block(linear, mixed, angular).shifted(self.x), (f, torque)


def make_cone(
    condim: int,
    frame: Matrix,
    friction: Vector,
    weight: Scalar,
    reference: Vector,
    impratio: Scalar | None,
    dtype: Any,
) -> Cone:
    """The force law of contact points, see `Cone`; pyramidal without an impratio, elliptic with one."""
    numbers = (frame, friction, weight, reference)
    if condim == 1:
        return Frictionless(*numbers)
    if impratio is None:
        return Pyramid(*numbers)
    return Ellipse(*numbers, impratio, float(np.sqrt(np.finfo(dtype).eps)))
