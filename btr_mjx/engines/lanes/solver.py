"""Newton's method on MuJoCo's convex constraint problem, run to a fixed active set.

The cost is quadratic on every zone of the constraints, so a full step from a zone lands on that zone's exact minimum,
and a solution is found when the zones at the minimum are the ones it was computed for. A world that has found its
solution computes the same numbers again, bit for bit, while its neighbours in the chunk still search.
"""

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes.contacts import Contact, Model
from btr_mjx.engines.lanes.factor import solve
from btr_mjx.engines.lanes.kinematics import Motion
from btr_mjx.engines.lanes.rows import Friction, Limit
from btr_mjx.engines.lanes.scalars import ZERO, Scalar, Vector, add, array, vadd
from btr_mjx.engines.lanes.spatial import (
    Block,
    Spatial,
    TreeMatrix,
    add_blocks,
    assemble,
    merge,
    project,
    propagate,
)
from btr_mjx.engines.lanes.tree import Plan

type Constraints = Sequence[Contact | Limit | Friction]


def _models(plan: Plan, motions: Sequence[Motion], constraints: Constraints, a: Sequence[jax.Array]) -> list[Model]:
    """Zone of every constraint at dof accelerations `a`."""
    spatial = propagate(plan, motions, a)
    return [
        c.model(c.acceleration(spatial[c.link.index])) if isinstance(c, Contact) else c.model(a[c.dof])
        for c in constraints
    ]


def _step(
    plan: Plan,
    motions: Sequence[Motion],
    constraints: Constraints,
    mass: TreeMatrix,
    smooth: Sequence[Scalar],
    models: Sequence[Model],
) -> list[Scalar]:
    """Minimum of the quadratic that the cost is on the given zones."""
    blocks: dict[int, Block] = {}
    wrenches: list[tuple[Vector, Vector]] = [(ZERO, ZERO)] * len(plan.links)
    matrix, right = dict(mass), list(smooth)
    for c, model in zip(constraints, models, strict=True):
        if isinstance(c, Contact):
            block, (force, torque) = c.effect(model)
            at = c.link.index
            blocks[at] = block if at not in blocks else add_blocks(blocks[at], block)
            wrenches[at] = (vadd(wrenches[at][0], force), vadd(wrenches[at][1], torque))
        else:
            stiffness, push = c.effect(model)
            matrix[c.dof, c.dof] = add(matrix[c.dof, c.dof], stiffness)
            right[c.dof] = add(right[c.dof], push)
    matrix = merge(matrix, assemble(plan, motions, blocks))
    forces: list[Spatial] = list(wrenches)
    return solve(plan, matrix, vadd(right, project(plan, motions, forces)))


def _moved(plan: Plan, constraints: Constraints, old: Sequence[Model], new: Sequence[Model]) -> jax.Array:
    """Which worlds (C,) have left the zones that they were solved for."""
    flags = []
    for before, after in zip(old, new, strict=True):
        flag = reduce(jnp.logical_or, [x != y for x, y in zip(before, after, strict=True)])
        flags += [flag[i] for i in range(flag.shape[0])] if flag.ndim == 2 else [flag]
    return reduce(jnp.logical_or, flags)


def constrained_acceleration(
    plan: Plan,
    motions: Sequence[Motion],
    constraints: Constraints,
    mass: TreeMatrix,
    smooth: Sequence[Scalar],
    guess: Sequence[jax.Array],
    max_newton: int,
) -> tuple[list[jax.Array], jax.Array]:
    """Joint accelerations under constraints.

    Args:
      plan: the static plan.
      motions: where the links are.
      constraints: contacts, limits and friction rows.
      mass: joint-space inertia.
      smooth: all forces but those of the constraints, per dof.
      guess: accelerations to start from, per dof (shape (C,) or (G, C)).
      max_newton: bound on the iterations.

    Returns:
      Accelerations per dof, and bool (C,), worlds that reached the bound.
    """
    lanes = guess[0].shape[-1]
    if not constraints:
        solution = solve(plan, mass, smooth)
        return [array(x, g.shape, g.dtype) for x, g in zip(solution, guess, strict=True)], jnp.zeros(lanes, bool)

    def shaped(models: Sequence[Model]) -> list[Model]:
        shapes = [(c.link.size if isinstance(c, Contact) else plan.dof_size[c.dof]) for c in constraints]
        full = [(lanes,) if size == 1 else (size, lanes) for size in shapes]
        return [tuple(array(x, s, guess[0].dtype) for x in model) for model, s in zip(models, full, strict=True)]

    def body(carry: tuple) -> tuple:
        count, _, _, models = carry
        a = _step(plan, motions, constraints, mass, smooth, models)
        a = [array(x, g.shape, g.dtype) for x, g in zip(a, guess, strict=True)]
        following = shaped(_models(plan, motions, constraints, a))
        return count + 1, _moved(plan, constraints, models, following), a, following

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < max_newton)

    start = shaped(_models(plan, motions, constraints, guess))
    carry = (jnp.int32(0), jnp.ones(lanes, bool), list(guess), start)
    _, moved, solution, _ = lax.while_loop(searching, body, carry)
    return solution, moved
