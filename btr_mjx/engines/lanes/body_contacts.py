"""Contact of spheres and capsules with each other: constraints that couple two bodies.

Distances are computed for all pairs side by side, as rows of arrays (P, C). Few of them touch at a time: the contacts of
each world are moved into K slots, arrays (K, C), so that the solver does not depend on the number of pairs. A sphere is
a capsule without length.

Source: google-deepmind/mujoco, mjraw_SphereSphere, mjraw_SphereCapsule, mjraw_CapsuleCapsule.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from btr_mjx.engines.guards.bounds import Shapes
from btr_mjx.engines.guards.pairs import PairGroup
from btr_mjx.engines.guards.places import PlacedGeoms, member
from btr_mjx.engines.lanes.cones import Cone, impedance, make_cone
from btr_mjx.engines.lanes.kinematics import Motion
from btr_mjx.engines.lanes.parameters import Parameters
from btr_mjx.engines.lanes.scalars import (
    Scalar,
    Vector,
    add,
    cross,
    dot,
    matvec,
    mul,
    neg,
    scale,
    sub,
    transpose,
    vadd,
    vsub,
)
from btr_mjx.engines.lanes.spatial import Spatial

MAX_TOUCHING = 8
"""Pairs of one condim that may touch at a time in a world; worlds with more are marked."""

type Member = tuple[int, int]
"""Index of a link, and the member of its group."""


@dataclass(frozen=True)
class Side:
    """The first or the second body of the contacts in the slots."""

    body: jax.Array
    """Position in the list of bodies, -1 for the world, (K, C)."""
    arm: Vector
    """Contact point relative to the origin of the body's link, world axes [m], (K, C)."""

    def movement(self, bodies: Sequence[Member], links: Sequence[Spatial]) -> list[Scalar]:
        """Velocity or acceleration of the contact points, without centripetal terms, from those of the links."""
        six = [_chosen(self.body, bodies, [[*v, *w][i] for v, w in links]) for i in range(6)]
        return vadd(six[:3], cross(six[3:], self.arm))


@dataclass(frozen=True)
class BodyContacts:
    """Contacts of pairs of one condim; empty slots have weight zero."""

    bodies: tuple[Member, ...]
    """Bodies that may take part."""
    first: Side
    second: Side
    cone: Cone
    """Its normal points from the first to the second body."""
    rows: int
    """Rows of the cone that are not always zero: 1 or 3."""

    @property
    def slots(self) -> int:
        """Number K of slots."""
        return self.first.body.shape[0]

    def acceleration(self, links: Sequence[Spatial]) -> list[Scalar]:
        """Relative acceleration of the bodies at the contact points in contact frames, from that of their links."""
        between = vsub(self.second.movement(self.bodies, links), self.first.movement(self.bodies, links))
        return [*matvec(self.cone.frame[: self.rows], between), 0.0, 0.0][:3]

    def wrenches(self, force: Vector) -> list[tuple[Member, list[jax.Array]]]:
        """What contact forces in contact frames exert on bodies, about their links' origins: six arrays (C,) each."""
        world = matvec(transpose(self.cone.frame[: self.rows]), force[: self.rows])
        sides = ((self.first, -1.0), (self.second, 1.0))
        parts = [(side, scale(sign, [*world, *cross(side.arm, world)])) for side, sign in sides]
        found = []
        for n, body in enumerate(self.bodies):
            own = [[jnp.where(side.body == n, x, 0) for x in six] for side, six in parts]
            found.append((body, [jnp.sum(x, axis=0) for x in vadd(*own)]))
        return found


def _chosen(body: jax.Array, bodies: Sequence[Member], table: Sequence[Scalar]) -> jax.Array:
    """One number of the link of each slot's body, (K, C); zero for the world."""
    found = jnp.zeros(())
    for n, (link, which) in enumerate(bodies):
        found = jnp.where(body == n, member(table[link], which), found)
    return jnp.broadcast_to(found, body.shape)


def body_contacts(
    groups: Sequence[tuple[PairGroup, Sequence[Member | None]]],
    parameters: Parameters,
    geoms: PlacedGeoms,
    motions: Sequence[Motion],
    elliptic: bool,
    dtype: Any,
) -> tuple[list[BodyContacts], jax.Array]:
    """Contacts between bodies, with MuJoCo's reference accelerations and weights.

    Args:
      groups: pairs, and the link of each geom.
      parameters: of this chunk.
      geoms: the geoms in the world.
      motions: poses and velocities of the links.
      elliptic: whether friction cones are elliptic rather than pyramidal.
      dtype: of the computation.

    Returns:
      The contacts of each group; and bool (C,), worlds in which more pairs touch than there are slots, or capsules that
      may touch are parallel, where MuJoCo finds two contacts.
    """
    found, marked = [], jnp.zeros(geoms.lanes, bool)
    for n, (group, carriers) in enumerate(groups):
        a, b = (geoms.shapes(kind, index) for kind, index in zip(group.kinds, (group.first, group.second), strict=True))
        pairs = _Touching(f"between{n}", group.condim, parameters, a, b, float(jnp.finfo(dtype).eps))
        slot, overflow = _slots(pairs.beyond < 0)
        marked = marked | overflow | pairs.doubtful
        both = [[carriers[i] for i in index] for index in (group.first, group.second)]
        bodies = tuple(sorted({body for side in both for body in side if body}))
        places = [np.array([bodies.index(body) if body else -1 for body in side]) for side in both]
        found.append(pairs.contacts(slot, bodies, places, motions, elliptic, dtype))
    return found, marked


def _slots(touching: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The pairs (K, C) that touch, in order, of flags (P, C); P where a slot is empty. And bool (C,), whether more do."""
    count = len(touching)
    number = jnp.arange(count, dtype=jnp.int32)[:, None]
    if count <= MAX_TOUCHING:
        return jnp.where(touching, number, count), jnp.zeros(touching.shape[1], bool)
    found, last = [], jnp.full(touching.shape[1], -1, jnp.int32)
    for _ in range(MAX_TOUCHING + 1):
        last = jnp.min(jnp.where(touching & (number > last), number, count), axis=0)
        found.append(last)
    return jnp.stack(found[:-1]), last < count


class _Touching:
    """Points and distances of the pairs of a group, (P, C)."""

    def __init__(self, key: str, condim: int, parameters: Parameters, a: Shapes, b: Shapes, eps: float):
        self.key, self.condim, self.parameters = key, condim, parameters
        one, other, parallel, slack = _nearest(a, b, eps)
        apart = vsub(other, one)
        square = dot(apart, apart)
        inverse = jax.lax.rsqrt(jnp.maximum(square, 1e-30))
        self.normal = scale(inverse, apart)
        distance = sub(mul(square, inverse), add(a.size[0], b.size[0]))
        self.beyond = sub(distance, parameters.one(f"{key}/margin"))
        self.point = vadd(one, scale(add(a.size[0], mul(0.5, distance)), self.normal))
        self.doubtful = jnp.any(parallel & (self.beyond < slack), axis=0)

    def contacts(
        self,
        slot: jax.Array,
        bodies: tuple[Member, ...],
        places: Sequence[np.ndarray],
        motions: Sequence[Motion],
        elliptic: bool,
        dtype: Any,
    ) -> BodyContacts:
        """The contacts in the slots.

        Args:
          slot: pair of each slot (K, C), P where it is empty.
          bodies: that take part.
          places: position in this list, -1 for the world, of the first and the second body of each pair.
          motions: of the links.
          elliptic: whether friction cones are elliptic.
          dtype: of the computation.
        """
        pairs = self.beyond.shape[0]
        filled, index = slot < pairs, jnp.minimum(slot, pairs - 1)

        def of(value: Scalar) -> Scalar:
            """A number of each slot's pair."""
            if isinstance(value, float) or np.ndim(value) < 2:
                return value
            if value.shape[1] == 1:
                return jnp.asarray(value[:, 0], dtype)[index]
            return jnp.take_along_axis(value, index, axis=0, mode="promise_in_bounds")

        def given(name: str) -> list[Scalar]:
            return [of(x) for x in self.parameters[f"{self.key}/{name}"]]

        beyond, normal, point = of(self.beyond), [of(x) for x in self.normal], [of(x) for x in self.point]
        frame = [normal, *_tangents(normal)]
        imp = impedance(given("impedance"), beyond)
        weight = jnp.where(filled, mul(given("scale")[0], imp / (1.0 - imp)), 0).astype(dtype)
        sides = []
        for place in places:
            body = jnp.asarray(place)[index]
            sides.append(
                Side(body, vsub(point, [_chosen(body, bodies, [m.position[i] for m in motions]) for i in range(3)]))
            )
        moves = [(m.velocity, m.angular_velocity) for m in motions]
        stiffness, damping = given("reference")
        velocity = matvec(frame, vsub(sides[1].movement(bodies, moves), sides[0].movement(bodies, moves)))
        reference = scale(neg(damping), velocity)
        reference[0] = sub(reference[0], mul(mul(stiffness, imp), beyond))
        impratio = self.parameters.one("world/impratio") if elliptic else None
        cone = make_cone(self.condim, frame, given("friction")[0], weight, reference, impratio, dtype)
        return BodyContacts(bodies, sides[0], sides[1], cone, 1 if self.condim == 1 else 3)


def _tangents(normal: Vector) -> list[list[Scalar]]:
    """Two tangents of each normal, as mju_makeFrame."""
    level = jnp.abs(normal[1]) < 0.5
    guess = [0.0, jnp.where(level, 1.0, 0.0), jnp.where(level, 0.0, 1.0)]
    tangent = vsub(guess, scale(dot(guess, normal), normal))
    tangent = scale(jax.lax.rsqrt(dot(tangent, tangent)), tangent)
    return [tangent, cross(normal, tangent)]


def _nearest(a: Shapes, b: Shapes, eps: float) -> tuple[list[Scalar], list[Scalar], jax.Array, jax.Array]:
    """Nearest points of the segments of capsules.

    Returns:
      A point of each; which are parallel; and by how much the distance of these may be too large [m].
    """
    first, second = scale(a.size[1], a.axes[2]), scale(b.size[1], b.axes[2])
    between = vsub(a.centre, b.centre)
    ma, mb, mc = dot(first, first), -dot(first, second), dot(second, second)
    u, v = -dot(first, between), dot(second, between)
    det = ma * mc - mb * mb
    parallel = det <= 100 * eps * ma * mc  # also where one is a sphere
    per_a, per_c = (jnp.where(x > 0, 1 / jnp.where(x > 0, x, 1), 0) for x in (ma, mc))
    x = jnp.where(parallel, 0.0, jnp.clip((mc * u - mb * v) / jnp.where(parallel, 1.0, det), -1.0, 1.0))
    free = (v - mb * x) * per_c
    y = jnp.clip(free, -1.0, 1.0)
    x = jnp.where((free != y) | parallel, jnp.clip((u - mb * y) * per_a, -1.0, 1.0), x)
    # A turn by the largest angle that counts as parallel moves the end of a segment by this much.
    slack = 20 * eps**0.5 * (a.size[1] + b.size[1])
    return vadd(a.centre, scale(x, first)), vadd(b.centre, scale(y, second)), parallel & (ma * mc > 0), slack
