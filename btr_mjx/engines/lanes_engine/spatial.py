"""Spatial vector algebra of the links: accelerations, wrenches and symmetric maps between them (inertias).

A link's spatial quantities refer to its own origin and to world axes: an acceleration is (linear, angular), a wrench
(force, torque).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from btr_mjx.engines.lanes_engine.kinematics import Motion
from btr_mjx.engines.lanes_engine.tree import Link, TreePlan
from btr_mjx.engines.scalars import (
    SIX,
    ZERO,
    Matrix,
    Scalar,
    Symmetric,
    Vector,
    add,
    cross,
    dot,
    full,
    group_sum,
    matvec,
    mul,
    neg,
    scale,
    sub,
    transpose,
    vadd,
    vsub,
)

type Spatial = tuple[Vector, Vector]
"""Linear and angular acceleration, or force and torque."""


@dataclass(frozen=True)
class Block:
    """A symmetric 6x6 map from a link's spatial acceleration to a wrench about the link's origin."""

    linear: Symmetric
    """Force from linear acceleration."""
    mixed: Matrix
    """Force from angular acceleration; its transpose gives torque from linear acceleration."""
    angular: Symmetric
    """Torque from angular acceleration."""

    def __add__(self, other: "Block") -> "Block":
        mixed = [vadd(x, y) for x, y in zip(self.mixed, other.mixed, strict=True)]
        return Block(vadd(self.linear, other.linear), mixed, vadd(self.angular, other.angular))

    def __matmul__(self, a: Spatial) -> Spatial:
        """Wrench of a spatial acceleration."""
        v, w = a
        force = vadd(matvec(full(self.linear), v), matvec(self.mixed, w))
        return force, vadd(matvec(transpose(self.mixed), v), matvec(full(self.angular), w))

    def times(self, factor: Scalar) -> "Block":
        """The block multiplied by a scalar."""
        mixed = [scale(factor, row) for row in self.mixed]
        return Block(scale(factor, self.linear), mixed, scale(factor, self.angular))

    def rank_one_downdate(self, u: Spatial, inverse: Scalar) -> "Block":
        """The block minus u u^T / d: the articulated inertia after one dof is eliminated; `inverse` is 1 / d."""
        (f, n), (g, o) = u, (scale(inverse, u[0]), scale(inverse, u[1]))
        linear = [sub(x, mul(f[i], g[j])) for x, (i, j) in zip(self.linear, SIX, strict=True)]
        mixed = [[sub(self.mixed[i][j], mul(f[i], o[j])) for j in range(3)] for i in range(3)]
        angular = [sub(x, mul(n[i], o[j])) for x, (i, j) in zip(self.angular, SIX, strict=True)]
        return Block(linear, mixed, angular)

    def shifted(self, arm: Vector) -> "Block":
        """The block about another point, displaced by minus `arm` (parallel axis theorem)."""
        # With R the cross-product matrix of the arm and K, B, J the three parts: B - K R and J - B^T R + R (B - K R).
        # A row times R is row x arm; R times a column is arm x column.
        mixed = [vsub(row, cross(k, arm)) for row, k in zip(self.mixed, full(self.linear), strict=True)]
        first = [cross(column, arm) for column in transpose(self.mixed)]
        second = transpose([cross(arm, column) for column in transpose(mixed)])
        angular = [add(sub(x, first[i][j]), second[i][j]) for x, (i, j) in zip(self.angular, SIX, strict=True)]
        return Block(self.linear, mixed, angular)

    def scalars(self) -> list[Scalar]:
        """The 21 entries."""
        return [*self.linear, *self.mixed[0], *self.mixed[1], *self.mixed[2], *self.angular]

    @classmethod
    def of(cls, numbers: Sequence[Scalar]) -> "Block":
        """Inverse of `scalars`."""
        return cls(numbers[:6], [numbers[6:9], numbers[9:12], numbers[12:15]], numbers[15:])


def point_block(k: Symmetric, x: Vector) -> Block:
    """The block of a 3x3 stiffness `k` at a point `x` relative to the origin."""
    mixed = [cross(x, row) for row in full(k)]
    columns = [cross(x, column) for column in transpose(mixed)]
    return Block(k, mixed, [columns[j][i] for i, j in SIX])


def rigid_block(mass: Scalar, h: Vector, inertia: Symmetric) -> Block:
    """Spatial inertia of a rigid body from its mass, sum of m c and inertia about the origin."""
    skew = [[0.0, h[2], neg(h[1])], [neg(h[2]), 0.0, h[0]], [h[1], neg(h[0]), 0.0]]
    return Block([mass, mass, mass, 0.0, 0.0, 0.0], skew, inertia)


def sum_over_group(plan: TreePlan, link: Link, values: Sequence[Scalar]) -> list[Scalar]:
    """Values that a link passes to its parent: summed over the group if the parent is not part of it."""
    group_ends = link.parent < 0 or plan.links[link.parent].size == 1
    return [group_sum(x, link.size) for x in values] if group_ends else list(values)


def acceleration_from_parent(link: Link, m: Motion, above: Sequence[Spatial]) -> Spatial:
    """Spatial acceleration of a link's origin due to its parent's acceleration."""
    if link.parent < 0:
        return ZERO, ZERO
    linear, angular = above[link.parent]
    return vadd(linear, cross(angular, m.arm)), angular


def propagate(plan: TreePlan, motions: Sequence[Motion], a: Sequence[Scalar]) -> list[Spatial]:
    """Spatial acceleration of every link caused by accelerations `a` of the dofs (J a)."""
    found: list[Spatial] = []
    for link, m in zip(plan.links, motions, strict=True):
        linear, angular = acceleration_from_parent(link, m, found)
        for k, (v, w) in zip(link.dofs, m.columns, strict=True):
            linear, angular = vadd(linear, scale(a[k], v)), vadd(angular, scale(a[k], w))
        found.append((linear, angular))
    return found


def generalised_force(column: Spatial, wrench: Spatial) -> Scalar:
    """Generalised force of a wrench along one dof."""
    return add(dot(column[0], wrench[0]), dot(column[1], wrench[1]))
