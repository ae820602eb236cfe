"""Solution of a symmetric positive definite system over a tree: LDL^T from the leaves to the roots, without fill-in.

Eliminating a dof touches only its ancestors (Featherstone's sparse factorisation, as in MuJoCo's mj_factorI). What
the members of a group add to their common ancestors is first summed over the dofs of the group, then once over its
members.
"""

from collections.abc import Sequence

from btr_mjx.engines.lanes.scalars import Scalar, add, group_sum, is_zero, mul, sub, total
from btr_mjx.engines.lanes.spatial import TreeMatrix
from btr_mjx.engines.lanes.tree import Plan


def solve(plan: Plan, matrix: TreeMatrix, right: Sequence[Scalar]) -> list[Scalar]:
    """Solve matrix @ x = right.

    Args:
      plan: the static plan; its dof order has ancestors first.
      matrix: entries (k, i), i an ancestor of k or k itself.
      right: right-hand side per dof.

    Returns:
      The solution per dof.
    """
    left, b = dict(matrix), list(right)
    inverse: list[Scalar] = [0.0] * len(b)
    lower: list[dict[int, Scalar]] = [{} for _ in b]
    waiting: dict[tuple[int, int], Scalar] = {}  # what a group takes from its common ancestors; (i, -1): right side
    for link in reversed(plan.links):
        for k in reversed(link.dofs):
            inverse[k] = 1.0 / left[k, k]
            row = {i: left[k, i] for i in plan.ancestors[k] if not is_zero(left.get((k, i), 0.0))}
            lower[k] = {i: mul(entry, inverse[k]) for i, entry in row.items()}
            for i, factor in lower[k].items():
                common = plan.dof_size[i] == 1 < plan.dof_size[k]
                for j in [j for j in row if j <= i] + [-1]:
                    change = mul(factor, row[j] if j >= 0 else b[k])
                    if common:
                        waiting[i, j] = add(waiting.get((i, j), 0.0), change)
                    elif j >= 0:
                        left[i, j] = sub(left.get((i, j), 0.0), change)
                    else:
                        b[i] = sub(b[i], change)
        if link.size > 1 and (link.parent < 0 or plan.links[link.parent].size == 1):
            for (i, j), change in waiting.items():
                if j >= 0:
                    left[i, j] = sub(left.get((i, j), 0.0), group_sum(change, link.size))
                else:
                    b[i] = sub(b[i], group_sum(change, link.size))
            waiting = {}
    x: list[Scalar] = []
    for k in range(len(b)):
        x.append(sub(mul(b[k], inverse[k]), total(mul(factor, x[i]) for i, factor in lower[k].items())))
    return x
