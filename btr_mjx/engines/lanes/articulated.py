"""Articulated-body algorithm: solves (J^T B J + diag) x = J^T f + tau in one sweep to the roots and one back.

B is one symmetric 6x6 block per link (its inertia and contact stiffness), f one wrench per link; diag and tau belong to
single dofs (armature, limits, actuators). Neither J nor the matrix over dofs is formed, and the cost is linear in the
number of links (Featherstone 2008, Rigid Body Dynamics Algorithms, chapter 7).
"""

from collections.abc import Mapping, Sequence

from btr_mjx.engines.lanes.kinematics import Motion
from btr_mjx.engines.lanes.scalars import (
    Scalar,
    Vector,
    add,
    cross,
    dot,
    full,
    is_zero,
    mul,
    scale,
    sub,
    total,
    vadd,
    vsub,
)
from btr_mjx.engines.lanes.spatial import Block, Spatial, acceleration_from_parent, generalised_force, sum_over_group
from btr_mjx.engines.lanes.tree import FREE, TreePlan


def solve_articulated(
    plan: TreePlan,
    motions: Sequence[Motion],
    blocks: Sequence[Block],
    wrenches: Sequence[Spatial],
    diagonal: Mapping[int, Scalar],
    tau: Mapping[int, Scalar],
) -> tuple[list[Scalar], list[Spatial]]:
    """Accelerations of dofs and links.

    Args:
      plan: the static plan.
      motions: poses and velocities of the links.
      blocks: B, per link, about its origin.
      wrenches: f, per link, about its origin.
      diagonal: diag, per dof; dofs of free joints have none (it belongs into the block of the root link).
      tau: forces along single dofs, none on free joints.

    Returns:
      x per dof, and the spatial acceleration J x per link.
    """
    inner, outer = list(blocks), list(wrenches)
    eliminated: dict[int, tuple[Spatial, Scalar, Scalar]] = {}
    for link, m in reversed(list(zip(plan.links, motions, strict=True))):
        block, wrench = inner[link.index], outer[link.index]
        if link.joints[0].kind == FREE:
            continue
        for k, column in reversed(list(zip(link.dofs, m.columns, strict=True))):
            u = block @ column
            inverse = 1.0 / add(generalised_force(column, u), diagonal.get(k, 0.0))
            force = mul(add(generalised_force(column, wrench), tau.get(k, 0.0)), inverse)
            eliminated[k] = u, inverse, force
            block = block.rank_one_downdate(u, inverse)
            wrench = vsub(wrench[0], scale(force, u[0])), vsub(wrench[1], scale(force, u[1]))
        if link.parent >= 0:
            torque = vadd(wrench[1], cross(m.arm, wrench[0]))
            up = sum_over_group(plan, link, [*block.shifted(m.arm).scalars(), *wrench[0], *torque])
            inner[link.parent] = inner[link.parent] + Block.of(up[:21])
            above = outer[link.parent]
            outer[link.parent] = vadd(above[0], up[21:24]), vadd(above[1], up[24:])
    x: list[Scalar] = []
    found: list[Spatial] = []
    for link, m in zip(plan.links, motions, strict=True):
        if link.joints[0].kind == FREE:
            six = _solve_six(inner[link.index], outer[link.index])
            x += six
            found.append((six[:3], six[3:]))
            continue
        linear, angular = acceleration_from_parent(link, m, found)
        for k, (v, w) in zip(link.dofs, m.columns, strict=True):
            (f, n), inverse, force = eliminated[k]
            x.append(sub(force, mul(inverse, add(dot(f, linear), dot(n, angular)))))
            linear, angular = vadd(linear, scale(x[k], v)), vadd(angular, scale(x[k], w))
        found.append((linear, angular))
    return x, found


def _solve_six(block: Block, wrench: Spatial) -> list[Scalar]:
    """Acceleration of a free link from its articulated inertia, by a dense 6x6 LDL^T decomposition."""
    linear, angular = full(block.linear), full(block.angular)
    matrix = [list(linear[i][: i + 1]) for i in range(3)]
    matrix += [[*(block.mixed[j][i] for j in range(3)), *angular[i][: i + 1]] for i in range(3)]
    return ldl_solve(matrix, [*wrench[0], *wrench[1]])


def ldl_solve(lower: Sequence[Sequence[Scalar]], right: Vector) -> list[Scalar]:
    """Solution (n,) of a symmetric positive definite system, given by the rows of its lower triangle (LDL^T)."""
    n = len(right)
    factor: list[list[Scalar]] = [[0.0] * n for _ in range(n)]  # L
    scaled: list[list[Scalar]] = [[0.0] * n for _ in range(n)]  # L D
    inverse: list[Scalar] = []
    y: list[Scalar] = []
    for j in range(n):
        for i in range(j, n):
            done = total(mul(factor[j][k], scaled[i][k]) for k in range(j))
            scaled[i][j] = sub(lower[i][j], done)
        inverse.append(1.0 / scaled[j][j])
        for i in range(j + 1, n):
            factor[i][j] = mul(scaled[i][j], inverse[j])
        y.append(sub(right[j], total(mul(factor[j][k], y[k]) for k in range(j) if not is_zero(factor[j][k]))))
    x: list[Scalar] = [0.0] * n
    for i in reversed(range(n)):
        x[i] = sub(mul(y[i], inverse[i]), total(mul(factor[k][i], x[k]) for k in range(i + 1, n)))
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
