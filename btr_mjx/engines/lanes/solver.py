"""Newton's method on MuJoCo's convex constraint problem, iterated until the zones of all constraints stay the same.

The cost is quadratic within a zone of the constraints (an active-set method): a full Newton step gives the exact
minimum for the assumed zones, and the solution is found when the zones at that minimum are the assumed ones. Elliptic
cones, whose sliding zone is not quadratic, and dry friction also need a line search.

The initial guess is the zones of the last step, which stay valid until a contact changes. It needs about 40 % fewer
iterations than the zones at the accelerations of the last step.

A world's result does not depend on the other worlds of its chunk: once converged, further iterations reproduce its
solution bit for bit; with a line search the solution is kept.
"""

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes.articulated import solve_articulated
from btr_mjx.engines.lanes.cones import Contact, Ellipse, ZoneModel
from btr_mjx.engines.lanes.dof_constraints import Friction
from btr_mjx.engines.lanes.linesearch import ConstraintProblem, Constraints, step_length
from btr_mjx.engines.lanes.scalars import Scalar, add, array, vadd
from btr_mjx.engines.lanes.spatial import Spatial, propagate
from btr_mjx.engines.rewriting import retrace

type Zones = list[tuple[jax.Array, ...]]
"""Per constraint, which of its rows were active in the last step: `flags` bool arrays of the constraint's shape."""


def _models(constraints: Constraints, a: Sequence[jax.Array], links: Sequence[Spatial]) -> list[ZoneModel]:
    """Zone of every constraint at accelerations `a` of the dofs and `links` of the links."""
    return [
        c.model(c.acceleration(links[c.link.index])) if isinstance(c, Contact) else c.model(a[c.dof])
        for c in constraints
    ]


def _minimum_on_zones(problem: ConstraintProblem, models: Sequence[ZoneModel]) -> tuple[list[Scalar], list[Spatial]]:
    """Minimum of the cost for given zones, where it is quadratic: accelerations of dofs and links."""
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


def _zones_changed(constraints: Constraints, old: Sequence[ZoneModel], new: Sequence[ZoneModel]) -> jax.Array:
    """Worlds, bool (C,), in which the zone of some constraint has changed."""
    flags = []
    for c, before, after in zip(constraints, old, new, strict=True):
        flag = ~c.same_zone(before, after)
        flags += [flag[i] for i in range(flag.shape[0])] if flag.ndim == 2 else [flag]
    return reduce(jnp.logical_or, flags)


def _zones_of_last_step(constraints: Constraints, zones: Zones, models: Sequence[ZoneModel]) -> list[ZoneModel]:
    """Zones of the last step for constraints that were active then; `models` for the others."""
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
    """Accelerations under constraints: the solution of the constraint problem.

    Args:
      problem: inertia, forces and constraints.
      guess: initial accelerations per dof, (C,) or (G, C).
      zones: of the last step; all False at the first step.
      max_newton: maximum number of iterations.

    Returns:
      Accelerations per dof; bool (C,), worlds that did not converge; the zones of the solution.
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
        x, links = _minimum_on_zones(problem, models)
        a = [array(x_k, g.shape, g.dtype) for x_k, g in zip(x, guess, strict=True)]
        if search:
            length = step_length(problem, old, a)
            a = [jnp.where(moving, y + length * (z - y), y) for y, z in zip(old, a, strict=True)]
            links = propagate(plan, motions, a)
        following = shaped(_models(constraints, a, links))
        moved = _zones_changed(constraints, models, following)
        if search:
            moved = moved & moving
            pairs = zip(models, following, strict=True)
            following = [tuple(jnp.where(moving, y, x) for x, y in zip(*pair, strict=True)) for pair in pairs]
        return count + 1, moved, a, following

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < max_newton)

    start = shaped(_models(constraints, guess, propagate(plan, motions, guess)))
    if not search:  # with a line search the zones must be those of the initial accelerations
        start = shaped(_zones_of_last_step(constraints, zones, start))
    carry = (jnp.int32(0), jnp.ones(lanes, bool), list(guess), start)
    # The loop takes most of a step's time: a lower threshold than elsewhere pays, at the cost of compile time.
    _, moved, solution, last = lax.while_loop(searching, retrace(body, threshold=8), carry)
    pushing = [tuple(x != 0 for x in model[: c.flags]) for c, model in zip(constraints, last, strict=True)]
    return solution, moved, pushing
