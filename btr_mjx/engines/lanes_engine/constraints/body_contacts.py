"""Contact of spheres and capsules with each other: constraints that couple two bodies.

Distances are computed for all pairs side by side, as rows of arrays (P, C). Few of them touch at a time: the contacts
of each world are moved into K slots, arrays (K, C), so that the solver does not depend on the number of pairs. A sphere
is a capsule without length.

Source: google-deepmind/mujoco, mjraw_SphereSphere, mjraw_SphereCapsule, mjraw_CapsuleCapsule.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import lax

from btr_mjx.engines.guards.bounds import Shapes
from btr_mjx.engines.guards.pairs import PairGroup
from btr_mjx.engines.guards.placed_geoms import PlacedGeoms, fold_rows, member
from btr_mjx.engines.lanes_engine.constraints.cones import Cone, impedance
from btr_mjx.engines.lanes_engine.constraints.friction_cones import make_cone
from btr_mjx.engines.lanes_engine.kinematics import Motion
from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.tree import TreePlan
from btr_mjx.engines.scalars import (
    Scalar,
    Vector,
    add,
    cross,
    dot,
    group_sum,
    mul,
    neg,
    padded,
    scale,
    sub,
    tangents,
    total,
    vadd,
    vsub,
)

MAX_TOUCHING = 8
"""Pairs of one condim that may touch at a time in a world; worlds with more are marked."""


@dataclass(frozen=True)
class Column:
    """A dof of a member of a group, and the bodies that it moves."""

    dof: int
    """Of the plan."""
    link: int
    member: int
    axis: int
    """Position among the dofs of its link."""
    first: int
    """The bodies that it moves are MuJoCo's numbers from `first` to `last`."""
    last: int


def columns(model: mujoco.MjModel, plan: TreePlan) -> list[Column]:
    """All dofs of a model, with the bodies that they move: MuJoCo numbers a subtree without gaps."""
    last = np.arange(model.nbody)
    for body in range(model.nbody - 1, 0, -1):
        parent = model.body_parentid[body]
        last[parent] = max(last[parent], last[body])
    return [
        Column(dof, link.index, which, axis, body, int(last[body]))
        for link in plan.links
        for which, body in enumerate(link.bodies)
        for axis, dof in enumerate(link.dofs)
    ]


@dataclass(frozen=True)
class Coupling:
    """Constraints between links, of one kind: contacts of pairs of one condim, closures, or rows over joints.

    They are in K slots; empty slots have weight zero.
    """

    columns: Sequence[Column]
    """Dofs that move one body of some pair and not the other, or that are in some row."""
    jacobian: Sequence[Vector]
    """Per row of the cone that is not always zero and per column, (K, C) or what broadcasts to it: for contacts the
    motion of the second body's contact point relative to the first's in the contact frame, and its rotation, per unit
    of the dof's velocity (of a free joint in world axes)."""
    cone: Cone
    """Its normal points from the first to the second body."""

    @property
    def slots(self) -> int:
        """Number K of slots."""
        return self.cone.weight.shape[0]

    @property
    def rows(self) -> int:
        """Rows of the cone that are not always zero: the condim."""
        return len(self.jacobian)

    def acceleration(self, a: Sequence[Scalar]) -> list[Scalar]:
        """Relative acceleration of the bodies at the contact points in contact frames, from that of the dofs."""
        own = [member(a[column.dof], column.member) for column in self.columns]
        return padded([dot(row, own) for row in self.jacobian], 3)

    def forces(self, force: Vector) -> list[tuple[Column, Scalar]]:
        """Forces along dofs, (C,), of contact forces in contact frames."""
        along = [
            total(mul(row[n], f) for row, f in zip(self.jacobian, force, strict=False))
            for n in range(len(self.columns))
        ]
        return [(column, over_slots(x)) for column, x in zip(self.columns, along, strict=True)]


def over_slots(x: jax.Array) -> jax.Array:
    """Sum over the slots, (C,), of an array (K, C)."""
    return group_sum(x, len(x)).reshape(x.shape[-1])


def body_contacts(
    groups: Sequence[PairGroup],
    owners: Sequence[int],
    moving: Sequence[Column],
    parameters: Parameters,
    geoms: PlacedGeoms,
    motions: Sequence[Motion],
    v: Sequence[jax.Array],
    elliptic: bool,
    dtype: Any,
) -> tuple[list[Coupling], jax.Array]:
    """Contacts of each group of pairs, with MuJoCo's reference accelerations and weights; and marked worlds, bool (C,).

    The owner of a geom is MuJoCo's number of the body that carries the joints, 0 for the world. Velocities are per dof,
    of free joints in world axes. A world is marked in which more pairs touch than there are slots, capsules that may
    touch are parallel, where MuJoCo finds two contacts, or the axes of capsules cross.
    """
    found, marked = [], jnp.zeros(geoms.lanes, bool)
    for n, group in enumerate(groups):
        a, b = (geoms.shapes(kind, index) for kind, index in zip(group.kinds, (group.first, group.second), strict=True))
        pairs = _Touching(f"between{n}", group.condim, parameters, a, b, float(jnp.finfo(dtype).eps))
        slot, overflow = _slots(pairs.beyond < 0)
        marked = marked | overflow | pairs.doubtful
        bodies = np.array([[owners[i] for i in index] for index in (group.first, group.second)])
        moves = [(bodies >= column.first) & (bodies <= column.last) for column in moving]
        chosen = [column for column, (one, other) in zip(moving, moves, strict=True) if np.any(one != other)]
        found.append(pairs.contacts(slot, bodies, chosen, motions, v, elliptic, dtype))
    return found, marked


def _slots(touching: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The pairs (K, C) that touch, of flags (P, C), and P where a slot is empty; and bool (C,), whether more touch."""
    count = len(touching)
    number = jnp.arange(count, dtype=jnp.int32)[:, None]
    if count <= MAX_TOUCHING:
        return jnp.where(touching, number, count), jnp.zeros(touching.shape[1], bool)
    found, last = [], jnp.full(touching.shape[1], -1, jnp.int32)
    for _ in range(MAX_TOUCHING + 1):
        last = fold_rows(jnp.minimum, lax.optimization_barrier(jnp.where(touching & (number > last), number, count)))
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
        radii = add(a.size[0], b.size[0])
        distance = sub(mul(square, inverse), radii)
        self.beyond = sub(distance, parameters.one(f"{key}/margin"))
        self.point = vadd(one, scale(add(a.size[0], mul(0.5, distance)), self.normal))
        crossing = square < eps * radii * radii  # the direction of the normal is lost in rounding
        self.doubtful = fold_rows(jnp.logical_or, (parallel & (self.beyond < slack)) | crossing)

    def contacts(
        self,
        slot: jax.Array,
        bodies: np.ndarray,
        moving: Sequence[Column],
        motions: Sequence[Motion],
        v: Sequence[jax.Array],
        elliptic: bool,
        dtype: Any,
    ) -> Coupling:
        """The contacts in the slots (K, C), which hold the number of a pair, or P where they are empty.

        `bodies` (2, P) are the first and the second body of each pair, `moving` the dofs that move one of them.
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
        frame = [normal, *tangents(normal)]
        imp = impedance(given("impedance"), beyond)
        weight = jnp.where(filled, mul(given("scale")[0], imp / (1.0 - imp)), 0).astype(dtype)
        one, other = (jnp.asarray(side, jnp.int32)[index] for side in bodies)
        shifts, turns = frame[: min(3, self.condim)], frame[: max(0, self.condim - 3)]
        jacobian: list[list[Scalar]] = [[] for _ in range(self.condim)]
        for column in moving:
            linear, angular = (
                [member(x, column.member) for x in part] for part in motions[column.link].columns[column.axis]
            )
            origin = [member(x, column.member) for x in motions[column.link].position]
            moved = vadd(linear, cross(angular, vsub(point, origin)))
            first, second = ((body >= column.first) & (body <= column.last) for body in (one, other))
            sign = second.astype(dtype) - first.astype(dtype)
            along = [(axis, moved) for axis in shifts] + [(axis, angular) for axis in turns]
            for row, (axis, rate) in zip(jacobian, along, strict=True):
                row.append(mul(sign, dot(axis, rate)))
        stiffness, damping = given("reference")
        velocity = [dot(row, [member(v[column.dof], column.member) for column in moving]) for row in jacobian]
        reference = padded(scale(neg(damping), velocity), 3)
        reference[0] = sub(reference[0], mul(mul(stiffness, imp), beyond))
        impratio = self.parameters.one("world/impratio") if elliptic else None
        cone = make_cone(self.condim, frame, given("friction"), weight, reference, impratio, dtype)
        return Coupling(moving, jacobian, cone)


def _nearest(a: Shapes, b: Shapes, eps: float) -> tuple[list[Scalar], list[Scalar], jax.Array, jax.Array]:
    """Nearest points of the segments of capsules; which are parallel; how much too large their distance may be [m]."""
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
