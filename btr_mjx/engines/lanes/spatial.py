"""Sums over a tree of rigid links: J a, J^T f and J^T B J without ever forming the Jacobian J.

A link's spatial quantities refer to its own origin: an acceleration is (linear, angular), a wrench (force, torque), a
block B maps the first to the second. Going to the parent moves the reference point along the link's arm and, when a
group of alike links ends, sums over its members.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from btr_mjx.engines.lanes.kinematics import Motion
from btr_mjx.engines.lanes.scalars import (
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
    is_zero,
    matvec,
    mul,
    scale,
    sub,
    total,
    transpose,
    vadd,
)
from btr_mjx.engines.lanes.tree import Link, Plan

type Spatial = tuple[Vector, Vector]
type TreeMatrix = dict[tuple[int, int], Scalar]
"""Entries (k, i) of a symmetric matrix over dofs, i an ancestor of k or k itself; absent entries are zero."""


@dataclass
class Block:
    """A symmetric map from a link's spatial acceleration to a wrench about the link's origin."""

    linear: Symmetric
    """Force from linear acceleration."""
    mixed: Matrix
    """Force from angular acceleration; its transpose gives torque from linear acceleration."""
    angular: Symmetric
    """Torque from angular acceleration."""


def _outgoing(plan: Plan, link: Link, values: Sequence[Scalar]) -> list[Scalar]:
    """Values of a link as its parent sees them: summed over the group if the group ends here."""
    alone = link.parent < 0 or plan.links[link.parent].size == 1
    return [group_sum(x, link.size) for x in values] if alone else list(values)


def propagate(plan: Plan, motions: Sequence[Motion], a: Sequence[Scalar]) -> list[Spatial]:
    """J a: spatial acceleration of every link caused by accelerations `a` of the dofs."""
    found: list[Spatial] = []
    for link, m in zip(plan.links, motions, strict=True):
        linear, angular = found[link.parent] if link.parent >= 0 else (ZERO, ZERO)
        linear = vadd(linear, cross(angular, m.arm)) if link.parent >= 0 else linear
        for k, (v, w) in zip(link.dofs, m.columns, strict=True):
            linear, angular = vadd(linear, scale(a[k], v)), vadd(angular, scale(a[k], w))
        found.append((linear, angular))
    return found


def project(plan: Plan, motions: Sequence[Motion], wrenches: Sequence[Spatial]) -> list[Scalar]:
    """J^T f: generalised forces of one wrench per link, each about its link's origin."""
    sums = [(list(force), list(torque)) for force, torque in wrenches]
    result: list[Scalar] = [0.0] * len(plan.dof_size)
    for link, m in reversed(list(zip(plan.links, motions, strict=True))):
        force, torque = sums[link.index]
        for k, (v, w) in zip(link.dofs, m.columns, strict=True):
            result[k] = add(dot(v, force), dot(w, torque))
        if link.parent >= 0:
            up = _outgoing(plan, link, [*force, *vadd(torque, cross(m.arm, force))])
            above = sums[link.parent]
            sums[link.parent] = (vadd(above[0], up[:3]), vadd(above[1], up[3:]))
    return result


def _climb(plan: Plan, motions: Sequence[Motion], link: Link, matrix: TreeMatrix, wrenches: Sequence[Spatial]) -> None:
    """Fill the rows of a link's dofs, given the wrench that each of them causes about the link's origin."""
    for (k, (force, torque)), own in zip(zip(link.dofs, wrenches, strict=True), range(len(link.dofs)), strict=True):
        for step, at in enumerate(plan.chain(link)):
            m = motions[at.index]
            dofs = list(zip(at.dofs, m.columns, strict=True))
            for i, (v, w) in dofs[: own + 1] if step == 0 else dofs:
                entry = add(dot(v, force), dot(w, torque))
                if not is_zero(entry):
                    matrix[k, i] = entry
            torque = vadd(torque, cross(m.arm, force))


def _moved_up(block: Block, arm: Vector) -> Block:
    """The block about a point that lies at minus `arm` from the present one."""
    # With R the cross matrix of the arm: mixed - K R and angular - mixed^T R + R (mixed - K R).
    # Row times R is row x arm; R times a column is arm x column.
    k = full(block.linear)
    mixed = [
        [sub(x, y) for x, y in zip(row, cross(k_row, arm), strict=True)]
        for row, k_row in zip(block.mixed, k, strict=True)
    ]
    first = [cross(column, arm) for column in transpose(block.mixed)]
    second = transpose([cross(arm, column) for column in transpose(mixed)])
    six = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    angular = [add(sub(s, first[i][j]), second[i][j]) for s, (i, j) in zip(block.angular, six, strict=True)]
    return Block(block.linear, mixed, angular)


def add_blocks(a: Block, b: Block) -> Block:
    """Sum of two blocks about the same origin."""
    mixed = [vadd(x, y) for x, y in zip(a.mixed, b.mixed, strict=True)]
    return Block(vadd(a.linear, b.linear), mixed, vadd(a.angular, b.angular))


def assemble(plan: Plan, motions: Sequence[Motion], blocks: Mapping[int, Block]) -> TreeMatrix:
    """J^T B J for one block per link (links without one are absent)."""
    matrix: TreeMatrix = {}
    sums: dict[int, Block] = dict(blocks)
    for link, m in reversed(list(zip(plan.links, motions, strict=True))):
        if link.index not in sums:
            continue
        block = sums[link.index]
        linear, angular, down = full(block.linear), full(block.angular), transpose(block.mixed)
        wrenches = [
            (vadd(matvec(linear, v), matvec(block.mixed, w)), vadd(matvec(down, v), matvec(angular, w)))
            for v, w in m.columns
        ]
        _climb(plan, motions, link, matrix, wrenches)
        if link.parent >= 0:
            up = _moved_up(block, m.arm)
            flat = _outgoing(plan, link, [*up.linear, *up.mixed[0], *up.mixed[1], *up.mixed[2], *up.angular])
            moved = Block(flat[:6], [flat[6:9], flat[9:12], flat[12:15]], flat[15:])
            sums[link.parent] = add_blocks(sums[link.parent], moved) if link.parent in sums else moved
    return matrix


def mass_matrix(
    plan: Plan, motions: Sequence[Motion], masses: Sequence[Scalar], moments: Sequence[tuple[Vector, Symmetric]]
) -> TreeMatrix:
    """Joint-space inertia by composite rigid bodies.

    Args:
      plan: the static plan.
      motions: where the links are.
      masses: per link, the mass of its whole subtree [kg].
      moments: per link, its own sum of m c [kg m] and inertia [kg m^2] about its origin, in world axes.

    Returns:
      The mass matrix without armature.
    """
    matrix: TreeMatrix = {}
    sums = [(list(h), list(inertia)) for h, inertia in moments]
    for link, m in reversed(list(zip(plan.links, motions, strict=True))):
        mass, (h, inertia) = masses[link.index], sums[link.index]
        wrenches = [
            (vadd(scale(mass, v), cross(w, h)), vadd(matvec(full(inertia), w), cross(h, v))) for v, w in m.columns
        ]
        _climb(plan, motions, link, matrix, wrenches)
        if link.parent >= 0:
            moved_h, moved = _shift_moments(mass, h, inertia, m.arm)
            flat = _outgoing(plan, link, [*moved_h, *moved])
            above = sums[link.parent]
            sums[link.parent] = (vadd(above[0], flat[:3]), vadd(above[1], flat[3:]))
    return matrix


def _shift_moments(mass: Scalar, h: Vector, inertia: Symmetric, arm: Vector) -> tuple[list[Scalar], list[Scalar]]:
    """First and second moments about a point that lies at minus `arm` from the present one."""
    # With u = h + m r / 2, the added inertia is 2 (r.u) 1 - r u^T - u r^T.
    half = vadd(h, scale(mul(0.5, mass), arm))
    products = [mul(2.0, mul(r, u)) for r, u in zip(arm, half, strict=True)]
    diagonal = [add(products[1], products[2]), add(products[0], products[2]), add(products[0], products[1])]
    off = [add(mul(arm[i], half[j]), mul(half[i], arm[j])) for i, j in ((0, 1), (0, 2), (1, 2))]
    moved = [add(x, y) for x, y in zip(inertia[:3], diagonal, strict=True)]
    moved += [sub(x, y) for x, y in zip(inertia[3:], off, strict=True)]
    return vadd(h, scale(mass, arm)), moved


def times(plan: Plan, matrix: TreeMatrix, x: Sequence[Scalar]) -> list[Scalar]:
    """Symmetric tree matrix times a vector over dofs."""
    terms: list[list[Scalar]] = [[] for _ in x]
    upward: dict[tuple[int, int], list[Scalar]] = {}
    for (k, i), entry in matrix.items():
        terms[k].append(mul(entry, x[i]))
        if k != i:
            upward.setdefault((i, plan.dof_size[k] if plan.dof_size[i] == 1 else 1), []).append(mul(entry, x[k]))
    for (i, size), items in upward.items():
        terms[i].append(group_sum(total(items), size))
    return [total(items) for items in terms]


def merge(a: TreeMatrix, b: TreeMatrix) -> TreeMatrix:
    """Sum of two tree matrices."""
    return {key: add(a.get(key, 0.0), b.get(key, 0.0)) for key in sorted(a.keys() | b.keys())}
