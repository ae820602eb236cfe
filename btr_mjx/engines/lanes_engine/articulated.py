"""Articulated-body algorithm: solves (J^T B J + diag) x = J^T f + tau in one sweep to the roots and one back.

B is one symmetric 6x6 block per link (its inertia and contact stiffness), f one wrench per link; diag and tau belong to
single dofs (armature, limits, actuators). Neither J nor the matrix over dofs is formed, and the cost is linear in the
number of links (Featherstone 2008, Rigid Body Dynamics Algorithms, chapter 7).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from btr_mjx.engines.lanes_engine.kinematics import Motion
from btr_mjx.engines.lanes_engine.spatial import (
    Block,
    Spatial,
    acceleration_from_parent,
    generalised_force,
    sum_over_group,
)
from btr_mjx.engines.lanes_engine.tree import FREE, TreePlan
from btr_mjx.engines.scalars import (
    Matrix,
    Scalar,
    Vector,
    add,
    cross,
    dot,
    full,
    mul,
    scale,
    sub,
    total,
    vadd,
    vsub,
)


@dataclass(frozen=True)
class Factors:
    """The matrix J^T B J + diag, factored."""

    plan: TreePlan
    motions: Sequence[Motion]
    eliminated: Mapping[int, tuple[Spatial, Scalar]]
    """Per dof of hinges and slides: articulated inertia times the dof's column, and the inverse of its own inertia."""
    roots: Mapping[int, Matrix]
    """Per link with a free joint: rows of the factor L below the diagonal, then the row of inverse pivots."""


def factorise(
    plan: TreePlan, motions: Sequence[Motion], blocks: Sequence[Block], diagonal: Mapping[int, Scalar]
) -> Factors:
    """Factor the matrix in a sweep to the roots: B per link about its origin, diag per dof.

    Dofs of free joints have no diag: it belongs into the block of the root link.
    """
    inner = list(blocks)
    eliminated: dict[int, tuple[Spatial, Scalar]] = {}
    roots: dict[int, Matrix] = {}
    for link, m in reversed(list(zip(plan.links, motions, strict=True))):
        block = inner[link.index]
        if link.joints[0].kind == FREE:
            roots[link.index] = ldl_factor(_dense(block))
            continue
        for k, column in reversed(list(zip(link.dofs, m.columns, strict=True))):
            u = block @ column
            inverse = 1.0 / add(generalised_force(column, u), diagonal.get(k, 0.0))
            eliminated[k] = u, inverse
            block = block.rank_one_downdate(u, inverse)
        if link.parent >= 0:
            up = sum_over_group(plan, link, block.shifted(m.arm).scalars())
            inner[link.parent] = inner[link.parent] + Block.of(up)
    return Factors(plan, motions, eliminated, roots)


def solve_factored(
    factors: Factors, wrenches: Sequence[Spatial], tau: Mapping[int, Scalar]
) -> tuple[list[Scalar], list[Spatial]]:
    """Accelerations x per dof, and spatial accelerations J x per link.

    Wrenches f are per link about its origin, forces tau along single dofs that do not belong to free joints.
    """
    plan, motions = factors.plan, factors.motions
    outer = list(wrenches)
    forces: dict[int, Scalar] = {}
    for link, m in reversed(list(zip(plan.links, motions, strict=True))):
        wrench = outer[link.index]
        if link.joints[0].kind == FREE:
            continue
        for k, column in reversed(list(zip(link.dofs, m.columns, strict=True))):
            u, inverse = factors.eliminated[k]
            forces[k] = force = mul(add(generalised_force(column, wrench), tau.get(k, 0.0)), inverse)
            wrench = vsub(wrench[0], scale(force, u[0])), vsub(wrench[1], scale(force, u[1]))
        if link.parent >= 0:
            torque = vadd(wrench[1], cross(m.arm, wrench[0]))
            up = sum_over_group(plan, link, [*wrench[0], *torque])
            above = outer[link.parent]
            outer[link.parent] = vadd(above[0], up[:3]), vadd(above[1], up[3:])
    x: list[Scalar] = []
    found: list[Spatial] = []
    for link, m in zip(plan.links, motions, strict=True):
        if link.joints[0].kind == FREE:
            six = ldl_apply(factors.roots[link.index], [*outer[link.index][0], *outer[link.index][1]])
            x += six
            found.append((six[:3], six[3:]))
            continue
        linear, angular = acceleration_from_parent(link, m, found)
        for k, (v, w) in zip(link.dofs, m.columns, strict=True):
            (f, n), inverse = factors.eliminated[k]
            x.append(sub(forces[k], mul(inverse, add(dot(f, linear), dot(n, angular)))))
            linear, angular = vadd(linear, scale(x[k], v)), vadd(angular, scale(x[k], w))
        found.append((linear, angular))
    return x, found


def _dense(block: Block) -> list[list[Scalar]]:
    """Rows of the lower triangle of a 6x6 block."""
    linear, angular = full(block.linear), full(block.angular)
    matrix = [list(linear[i][: i + 1]) for i in range(3)]
    return matrix + [[*(block.mixed[j][i] for j in range(3)), *angular[i][: i + 1]] for i in range(3)]


def ldl_factor(lower: Sequence[Sequence[Scalar]]) -> list[list[Scalar]]:
    """Rows of L below the diagonal, then the inverses of D, of a matrix L D L^T given by its lower triangle."""
    n = len(lower)
    factor: list[list[Scalar]] = [[0.0] * i for i in range(n)]
    scaled: list[list[Scalar]] = [[0.0] * n for _ in range(n)]  # L D
    inverse: list[Scalar] = []
    for j in range(n):
        for i in range(j, n):
            scaled[i][j] = sub(lower[i][j], total(mul(factor[j][k], scaled[i][k]) for k in range(j)))
        inverse.append(1.0 / scaled[j][j])
        for i in range(j + 1, n):
            factor[i][j] = mul(scaled[i][j], inverse[j])
    return [*factor, inverse]


def ldl_apply(factors: Matrix, right: Vector) -> list[Scalar]:
    """Solution (n,) of a system whose matrix `ldl_factor` has factored."""
    *factor, inverse = factors
    y: list[Scalar] = []
    for row, value in zip(factor, right, strict=True):
        y.append(sub(value, total(mul(a, b) for a, b in zip(row, y, strict=True))))
    x: list[Scalar] = [0.0] * len(y)
    for i in reversed(range(len(y))):
        x[i] = sub(mul(y[i], inverse[i]), total(mul(factor[k][i], x[k]) for k in range(i + 1, len(y))))
    return x


def lu_solve(rows: Sequence[Sequence[Scalar]], right: Vector) -> list[Scalar]:
    """Solution (n,) of a small unsymmetric system by Gaussian elimination without pivoting.

    The symmetric part of the matrix must be positive definite.
    """
    n = len(right)
    a, b = [list(row) for row in rows], list(right)
    inverse: list[Scalar] = []
    for k in range(n):
        inverse.append(1.0 / a[k][k])
        for i in range(k + 1, n):
            factor = mul(a[i][k], inverse[k])
            a[i] = [sub(a[i][j], mul(factor, a[k][j])) if j > k else 0.0 for j in range(n)]
            b[i] = sub(b[i], mul(factor, b[k]))
    x: list[Scalar] = [0.0] * n
    for k in reversed(range(n)):
        x[k] = mul(sub(b[k], total(mul(a[k][j], x[j]) for j in range(k + 1, n))), inverse[k])
    return x
