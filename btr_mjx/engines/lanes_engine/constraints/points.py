"""Contact points of a link with a plane, side by side, of which only those that touch are visited.

A robot has many points that could touch the floor and few that do. Those of one law are arrays (P, C), or (P, G, C) for
the members of a group. A loop visits the points that touch in some world of the chunk, which are known at run time
only; in the other worlds they have weight zero, so that the results of a world do not depend on its neighbours.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from btr_mjx.engines.lanes_engine.constraints.cones import Cone, ZoneModel
from btr_mjx.engines.lanes_engine.spatial import Block, Spatial, point_block
from btr_mjx.engines.lanes_engine.tree import Link
from btr_mjx.engines.scalars import (
    SIX,
    Scalar,
    Vector,
    array,
    cross,
    full,
    matmul,
    matvec,
    padded,
    sandwich,
    transpose,
    vadd,
)

_MOST = 31
"""Points of one loop: the bits of a number."""


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
        stiffness, force = self.cone.stiffness(model), self.cone.force(model, self.cone.reference)
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


@dataclass(frozen=True)
class Points:
    """Contact points of one link with one law."""

    link: Link
    count: int
    rows: int
    quadratic: bool
    """See `Cone`, of each point."""
    touching: jax.Array
    """int32 (): bit p says whether point p touches in some world."""
    at: Callable[[jax.Array], Contact]
    """The point of a number."""

    def visit[T](self, one: Callable[[jax.Array, Contact, T], T], start: T) -> T:
        """The result of `one`, which takes the number of a point, the point and the result so far, after all points."""
        if self.count == 1 or jax.default_backend() != "cpu":  # a loop costs more than points that do not touch
            for p in range(self.count):
                start = one(jnp.int32(p), self.at(jnp.int32(p)), start)
            return start

        def following(carry: tuple) -> tuple:
            left, result = carry
            p = lax.population_count((left & -left) - 1)
            return left & (left - 1), one(p, self.at(p), result)

        return lax.while_loop(lambda carry: carry[0] != 0, following, (self.touching, start))[1]


def side_by_side(contacts: Sequence[Contact], lanes: int, dtype: Any) -> list[Points]:
    """Contacts that have the link, the number of rows and the frame in common, side by side."""
    groups: list[list[Contact]] = []
    for contact in contacts:
        for group in groups:
            if len(group) < _MOST and _alike(contact, group[0]):
                group.append(contact)
                break
        else:
            groups.append([contact])
    return [_points(group, lanes, dtype) for group in groups]


def _alike(one: Contact, other: Contact) -> bool:
    same = one.link is other.link and type(one.cone) is type(other.cone) and one.cone.rows == other.cone.rows
    rows = zip(one.cone.frame, other.cone.frame, strict=True)
    return same and all(_equal(x, y) for a, b in rows for x, y in zip(a, b, strict=True))


def _equal(x: Any, y: Any) -> bool:
    return x is y or (not isinstance(x, jax.Array) and not isinstance(y, jax.Array) and np.array_equal(x, y))


def _points(group: Sequence[Contact], lanes: int, dtype: Any) -> Points:
    first = group[0]
    shape = (lanes,) if first.link.size == 1 else (first.link.size, lanes)
    columns = [_column(column, shape, dtype) for column in zip(*map(_numbers, group), strict=True)]
    touches = jnp.zeros(lanes, jnp.int32)
    for p, contact in enumerate(group):
        active = array(contact.cone.weight, shape, dtype) != 0
        for one in active if active.ndim == 2 else [active]:
            touches = touches | jnp.where(one, 1 << p, 0)

    def at(p: jax.Array) -> Contact:
        found = [lax.dynamic_index_in_dim(x, p, keepdims=False) if many else x for x, many in columns]
        places, friction, (weight, *reference) = (
            found[:3],
            found[3 : -1 - len(first.cone.reference)],
            found[-1 - len(first.cone.reference) :],
        )
        return replace(first, x=places, cone=replace(first.cone, friction=friction, weight=weight, reference=reference))

    return Points(first.link, len(group), first.cone.rows, first.cone.quadratic, jnp.bitwise_or.reduce(touches), at)


def _numbers(contact: Contact) -> list[Scalar]:
    """All numbers of a point but its frame."""
    return [*contact.x, *contact.cone.friction, contact.cone.weight, *contact.cone.reference]


def _column(column: Sequence[Scalar], shape: tuple[int, ...], dtype: Any) -> tuple[Scalar, bool]:
    """The same number of all points, and whether it differs between them, along its first axis."""
    if all(_equal(x, column[0]) for x in column):
        return column[0], False
    known = not any(isinstance(x, jax.Array) for x in column)
    own = (*shape[:-1], 1) if known else shape
    # Without the barrier XLA fuses the concatenation into its consumers, as a chain of branches for every element.
    return lax.optimization_barrier(jnp.stack([array(x, own, dtype) for x in column])), True
