"""Newton's method on MuJoCo's convex constraint problem, run until the zones of all constraints stay the same.

The cost is quadratic on every zone of the constraints, so a full step from a zone lands on that zone's exact minimum,
and a solution is found when the zones at the minimum are the ones it was computed for. Elliptic cones, whose sides are
not quadratic, and dry friction need a line search besides.

The first guess is the zones of the last step, which hold until a contact really changes: from the accelerations of the
last step alone, a search takes 3.6 iterations on the hexapod until all of 64 worlds are done, from its zones 2.2.

A world's result does not depend on its neighbours: one that has found its solution computes the same numbers again,
bit for bit, or keeps them where a line search might move them, while its neighbours in the chunk still search.
"""

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes.articulated import solve_articulated
from btr_mjx.engines.lanes.contacts import Contact, Ellipse, ZoneModel
from btr_mjx.engines.lanes.linesearch import ConstraintProblem, Constraints, step_length
from btr_mjx.engines.lanes.retrace import retrace
from btr_mjx.engines.lanes.rows import Friction
from btr_mjx.engines.lanes.scalars import Scalar, add, array, vadd
from btr_mjx.engines.lanes.spatial import Spatial, propagate

type Zones = list[tuple[jax.Array, ...]]
"""Per constraint, which of its rows pushed in the last step, `flags` bool arrays of the constraint's shape each."""


def _models(constraints: Constraints, a: Sequence[jax.Array], links: Sequence[Spatial]) -> list[ZoneModel]:
    """Zone of every constraint at accelerations `a` of the dofs and `links` of the links."""
    return [
        c.model(c.acceleration(links[c.link.index])) if isinstance(c, Contact) else c.model(a[c.dof])
        for c in constraints
    ]


def _step(problem: ConstraintProblem, models: Sequence[ZoneModel]) -> tuple[list[Scalar], list[Spatial]]:
    """Minimum of the quadratic that the cost is on the given zones: accelerations of dofs and links."""
    blocks, outer = list(problem.inertia.blocks), list(problem.wrenches)
    diagonal, forces = dict(problem.inertia.diagonal), dict(problem.tau)
    for c, model in zip(problem.constraints, models, strict=True):
        if isinstance(c, Contact):
            block, (force, torque) = c.effect(model)
            at = c.link.index
            blocks[at] = blocks[at] + block
            outer[at] = vadd(outer[at][0], force), vadd(outer[at][1], torque)
        else:
            stiffness, push = c.effect(model)
            diagonal[c.dof] = add(diagonal.get(c.dof, 0.0), stiffness)
            forces[c.dof] = add(forces.get(c.dof, 0.0), push)
    return solve_articulated(problem.plan, problem.motions, blocks, outer, diagonal, forces)


def _moved(constraints: Constraints, old: Sequence[ZoneModel], new: Sequence[ZoneModel]) -> jax.Array:
    """Which worlds (C,) have left the zones that they were solved for."""
    flags = []
    for c, before, after in zip(constraints, old, new, strict=True):
        flag = ~c.settled(before, after)
        flags += [flag[i] for i in range(flag.shape[0])] if flag.ndim == 2 else [flag]
    return reduce(jnp.logical_or, flags)


def _recalled(constraints: Constraints, zones: Zones, models: Sequence[ZoneModel]) -> list[ZoneModel]:
    """Zones of the last step for constraints that pushed then; `models` for those that did not."""
    found: list[ZoneModel] = []
    for c, flags, model in zip(constraints, zones, models, strict=True):
        if not flags:
            found.append(model)
            continue
        pushed = reduce(jnp.logical_or, flags)
        pairs = zip(flags, model, strict=True)
        found.append(tuple(jnp.where(pushed, jnp.where(flag, c.weight, 0), x) for flag, x in pairs))
    return found


def constrained_acceleration(
    problem: ConstraintProblem,
    guess: Sequence[jax.Array],
    zones: Zones,
    max_newton: int,
) -> tuple[list[jax.Array], jax.Array, Zones]:
    """Joint accelerations under constraints.

    Args:
      problem: inertia, forces and constraints.
      guess: accelerations to start from, per dof (shape (C,) or (G, C)).
      zones: of the last step; all False where there was none.
      max_newton: bound on the iterations.

    Returns:
      Accelerations per dof; bool (C,), worlds that reached the bound; the zones of the solution.
    """
    plan, motions, constraints, inertia = problem.plan, problem.motions, problem.constraints, problem.inertia
    lanes = guess[0].shape[-1]
    if not constraints:
        solution, _ = solve_articulated(plan, motions, inertia.blocks, problem.wrenches, inertia.diagonal, problem.tau)
        return [array(x, g.shape, g.dtype) for x, g in zip(solution, guess, strict=True)], jnp.zeros(lanes, bool), []
    search = any(isinstance(c, Ellipse | Friction) for c in constraints)

    def shaped(models: Sequence[ZoneModel]) -> list[ZoneModel]:
        shapes = [(c.link.size if isinstance(c, Contact) else plan.dof_size[c.dof]) for c in constraints]
        full = [(lanes,) if size == 1 else (size, lanes) for size in shapes]
        return [tuple(array(x, s, guess[0].dtype) for x in model) for model, s in zip(models, full, strict=True)]

    def body(carry: tuple) -> tuple:
        count, moving, old, models = carry
        x, links = _step(problem, models)
        a = [array(x_k, g.shape, g.dtype) for x_k, g in zip(x, guess, strict=True)]
        if search:
            length = step_length(problem, old, a)
            a = [jnp.where(moving, y + length * (z - y), y) for y, z in zip(old, a, strict=True)]
            links = propagate(plan, motions, a)
        following = shaped(_models(constraints, a, links))
        moved = _moved(constraints, models, following)
        if search:
            moved = moved & moving
            pairs = zip(models, following, strict=True)
            following = [tuple(jnp.where(moving, y, x) for x, y in zip(*pair, strict=True)) for pair in pairs]
        return count + 1, moved, a, following

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < max_newton)

    start = shaped(_models(constraints, guess, propagate(plan, motions, guess)))
    if not search:  # a line search starts from accelerations, and its zones must be theirs
        start = shaped(_recalled(constraints, zones, start))
    carry = (jnp.int32(0), jnp.ones(lanes, bool), list(guess), start)
    # The loop is two thirds of a step's time: materialise more here than elsewhere, for more compile time.
    _, moved, solution, last = lax.while_loop(searching, retrace(body, threshold=8), carry)
    pushing = [tuple(x != 0 for x in model[: c.flags]) for c, model in zip(constraints, last, strict=True)]
    return solution, moved, pushing
