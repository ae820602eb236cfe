"""Force laws of contact points with friction: pyramidal and elliptic cones (mj_constraintUpdate)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from btr_mjx.engines.lanes_engine.constraints.cones import Cone, Frictionless, ZoneModel
from btr_mjx.engines.scalars import Matrix, Scalar, Symmetric, Vector, add, dot, mul, padded, scale, sub, total, vadd

_ROUNDINGS = 16
"""Units of rounding within which two forces of an elliptic cone count as equal."""

_KINDS = (0, 0, 1, 2, 2)
"""Friction of each row but the first: sliding along two tangents, spinning, rolling about both tangents."""


class Pyramid(Cone):
    """A contact with a friction pyramid: two opposite edges for each row but the first."""

    def model(self, short: Vector) -> ZoneModel:
        """Weights of the active edges, zero for the others."""
        sides = [mul(self.friction[kind], x) for kind, x in zip(_KINDS, short[1:], strict=False)]
        edges = [edge(short[0], side) for side in sides for edge in (add, sub)]
        return tuple(jnp.where(edge > 0, self.weight, 0) for edge in edges)

    def stiffness(self, model: ZoneModel) -> Symmetric:
        """See `Cone.stiffness`."""
        edges = list(zip(model[::2], model[1::2], strict=True))
        pairs = [add(one, other) for one, other in edges]
        skews = [mul(self.friction[kind], sub(*edge)) for kind, edge in zip(_KINDS, edges, strict=False)]
        squares = [mul(mu, mu) for mu in self.friction]
        diagonal = [total(pairs), *(mul(squares[kind], pair) for kind, pair in zip(_KINDS, pairs, strict=False))]
        n = len(diagonal)
        return padded([*diagonal, *skews], n * (n + 1) // 2)


@dataclass
class Ellipse(Cone):
    """A contact with an elliptic cone (mj_constraintUpdate); in the sliding zone the cost is not quadratic.

    In components n, t_i in which the cone is round, with the slope c of its wall and the direction e of t, the cost is
    strength/2 (n + c |t|)^2 where the contact slides and sticking/2 (n^2 + t^2) where it sticks. The stiffness is
    [[normal, bend e^T], [bend e, side + twist e e^T]]; at the shortfall at which it is taken the force is the stiffness
    times the shortfall, since the cost is homogeneous.
    """

    impratio: Scalar
    tolerance: float
    """Difference of two forces, relative to their terms, that counts as none: rounding."""

    quadratic: ClassVar[bool] = False

    def __post_init__(self) -> None:
        known = isinstance(self.impratio, float)
        self._slope = mul(self.friction[0], self.impratio**-0.5 if known else jax.lax.rsqrt(self.impratio))
        square = mul(self._slope, self._slope)
        self._sticking = mul(1.0 / square, self.weight)
        self._strength = mul(1.0 / add(1.0, square), self._sticking)
        self._scales = [self._slope, *(self.friction[kind] for kind in _KINDS[: len(self.reference) - 1])]

    def _round(self, short: Vector) -> Vector:
        """Components in which the cone is round."""
        return [mul(s, x) for s, x in zip(self._scales, short, strict=True)]

    def _zone(self, n: Scalar, sides: Vector) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Length of the sides and its inverse (0 and 1 where they vanish); whether the contact is separated, sticks."""
        square = dot(sides, sides)
        slides = square > 0
        t = jnp.sqrt(jnp.where(slides, square, 1.0)) * slides
        separated = (n <= -self._slope * t) & (slides | (n <= 0))
        sticks = (t <= self._slope * n) & (slides | (n > 0))
        return t, 1.0 / jnp.where(slides, t, 1.0), separated, sticks

    def model(self, short: Vector) -> ZoneModel:
        """Coefficients of the stiffness, and the direction of the sides."""
        cone, strength = self._slope, self._strength
        n, *sides = self._round(short)
        t, inverse, separated, sticks = self._zone(n, sides)
        push = strength * (n + cone * t) * cone
        side = push * inverse
        sliding = (strength, side, strength * cone, strength * cone * cone - side)
        pairs = zip((self._sticking, self._sticking, 0, 0), sliding, strict=True)
        found = [jnp.where(separated, 0, jnp.where(sticks, x, y)) for x, y in pairs]
        return *found, *(x * inverse for x in sides)

    def stiffness(self, model: ZoneModel) -> Symmetric:
        """See `Cone.stiffness`."""
        normal, side, bend, twist, *along = model
        first, *rest = self._scales
        along = [mul(s, e) for s, e in zip(rest, along, strict=True)]
        return [
            first * first * normal,
            *(s * s * side + twist * e * e for s, e in zip(rest, along, strict=True)),
            *(first * bend * e for e in along),
            *(twist * e * f for e, f in combinations(along, 2)),
        ]

    def _round_force(self, model: ZoneModel, n: Scalar, sides: Vector) -> Vector:
        normal, side, bend, twist, *along = model
        slid = dot(along, sides)
        turn = bend * n + twist * slid
        return [normal * n + bend * slid, *(side * x + turn * e for x, e in zip(sides, along, strict=True))]

    def force(self, model: ZoneModel, short: Vector) -> Vector:
        """See `Cone.force`."""
        n, *sides = self._round(short)
        return self._round(self._round_force(model, n, sides))

    def settled(self, model: ZoneModel, short: Vector) -> jax.Array:
        """See `Cone.settled`."""
        n, *sides = self._round(short)
        pairs = zip(self._round_force(model, n, sides), self._round_force(self.model(short), n, sides), strict=True)
        change = reduce(jnp.maximum, [jnp.abs(x - y) for x, y in pairs])
        size = self._sticking * reduce(jnp.maximum, [jnp.abs(x) for x in (n, *sides)])
        return ~(change > self.tolerance * size)

    def slopes(self, start: Vector, along: Vector) -> Callable[[Scalar], tuple[Scalar, Scalar]]:
        """See `Cone.slopes`; without the matrices, since a search asks for it many times."""
        cone = self._slope
        (n0, *sides0), (n1, *sides1) = self._round(start), self._round(along)
        square = dot(sides1, sides1)
        bend = self._sticking * (n1 * n1 + square)
        pull = self._sticking * (n0 * n1 + dot(sides0, sides1))

        def at(length: Scalar) -> tuple[Scalar, Scalar]:
            n, sides = add(n0, mul(length, n1)), vadd(sides0, scale(length, sides1))
            t, inverse, separated, sticks = self._zone(n, sides)
            speed = dot(sides, sides1) * inverse  # of t
            gap, faster = n + cone * t, n1 + cone * speed
            turning = (square - speed * speed) * inverse
            first = jnp.where(sticks, pull + length * bend, self._strength * gap * faster)
            second = jnp.where(sticks, bend, self._strength * (faster * faster + cone * gap * turning))
            return jnp.where(separated, 0, first), jnp.where(separated, 0, second)

        return at


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
    return Ellipse(*numbers, impratio, _ROUNDINGS * float(np.finfo(dtype).eps))
