"""Newton's method on MuJoCo's convex constraint problem, iterated until the zones of all constraints stay the same.

The cost is quadratic within a zone of the constraints (an active-set method): a full Newton step gives the exact
minimum for the assumed zones, and the solution is found when the zones at that minimum are the assumed ones. Elliptic
cones, whose sliding zone is not quadratic, and dry friction also need a line search.

The initial guess is the zones of the last step, which stay valid until a contact changes. It needs about 40 % fewer
iterations than the zones at the accelerations of the last step.

A world's result does not depend on the other worlds of its chunk: once converged, further iterations reproduce its
solution bit for bit; with a line search the solution is kept.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes_engine.articulated import factorise, solve_factored
from btr_mjx.engines.lanes_engine.constraints.body_contacts import Coupling, over_slots
from btr_mjx.engines.lanes_engine.constraints.cones import Cone, Contact, ZoneModel
from btr_mjx.engines.lanes_engine.constraints.coupled import solve_coupled
from btr_mjx.engines.lanes_engine.constraints.dof_constraints import DofConstraint
from btr_mjx.engines.lanes_engine.dynamics import System
from btr_mjx.engines.lanes_engine.kinematics import Motion
from btr_mjx.engines.lanes_engine.spatial import Spatial, generalised_force, propagate
from btr_mjx.engines.lanes_engine.tree import TreePlan
from btr_mjx.engines.rewriting import retrace
from btr_mjx.engines.scalars import (
    Scalar,
    add,
    array,
    group_sum,
    mul,
    sub,
    vadd,
    vsub,
)

_MAX_NEWTON = 20
"""Iterations of a step."""

_LINE_ITERATIONS = 10
"""Iterations of the line search."""

_SLOPE_TOLERANCE = 1e-3
"""Slope at which the search stops, relative to the slope at its start."""

type Constraint = Contact | Coupling | DofConstraint


@dataclass(frozen=True)
class ConstraintProblem:
    """MuJoCo's convex problem for the accelerations of one step: inertia, forces and constraints."""

    plan: TreePlan
    motions: Sequence[Motion]
    """Poses and velocities of the links."""
    constraints: Sequence[Constraint]
    """Contacts, limits and friction rows."""
    inertia: System
    """Of all links, with armature."""
    wrenches: Sequence[Spatial]
    """All forces on links except constraint forces, about the links' origins."""
    tau: Mapping[int, Scalar]
    """All forces along single dofs except constraint forces."""


type Zones = list[tuple[jax.Array, ...]]
"""Per constraint, which of its rows were active in the last step: `flags` bool arrays of the constraint's shape."""


def _law(c: Constraint) -> Cone | DofConstraint:
    """What a constraint's force depends on."""
    return c if isinstance(c, DofConstraint) else c.cone


def zone_shape(plan: TreePlan, c: Constraint, lanes: int) -> tuple[int, ...]:
    """Shape of a coefficient of a constraint's zone."""
    if isinstance(c, Coupling):
        return c.slots, lanes
    size = c.link.size if isinstance(c, Contact) else plan.dof_size[c.dof]
    return (lanes,) if size == 1 else (size, lanes)


def zone_flags(c: Constraint) -> int:
    """Number of flags that describe a constraint's zone, see `Cone.flags`."""
    return _law(c).flags


def _models(constraints: Sequence[Constraint], a: Sequence[jax.Array], links: Sequence[Spatial]) -> list[ZoneModel]:
    """Zone of every constraint at accelerations `a` of the dofs and `links` of the links."""
    found = []
    for c in constraints:
        if isinstance(c, DofConstraint):
            found.append(c.model(a[c.dof]))
        elif isinstance(c, Contact):
            found.append(c.cone.model(c.acceleration(links[c.link.index])))
        else:
            found.append(c.cone.model(c.acceleration(a)))
    return found


def _minimum_on_zones(
    problem: ConstraintProblem, models: Sequence[ZoneModel], like: Sequence[jax.Array]
) -> tuple[list[Scalar], list[Spatial]]:
    """Minimum of the cost for given zones, where it is quadratic: accelerations of dofs and links."""
    blocks, outer = list(problem.inertia.blocks), list(problem.wrenches)
    diagonal, forces = dict(problem.inertia.diagonal), dict(problem.tau)
    couplings = []
    for c, model in zip(problem.constraints, models, strict=True):
        if isinstance(c, Coupling):
            couplings.append((c, model))
        elif isinstance(c, Contact):
            block, (force, torque) = c.effect(model)
            at = c.link.index
            blocks[at] = blocks[at] + block
            outer[at] = vadd(outer[at][0], force), vadd(outer[at][1], torque)
        else:
            stiffness, push = c.effect(model)
            diagonal[c.dof] = add(diagonal.get(c.dof, 0.0), stiffness)
            forces[c.dof] = add(forces.get(c.dof, 0.0), push)
    factors = factorise(problem.plan, problem.motions, blocks, diagonal)
    if not couplings:
        return solve_factored(factors, outer, forces)
    return solve_coupled(factors, couplings, outer, forces, like)


def _zones_changed(constraints: Sequence[Constraint], old: Sequence[ZoneModel], new: Sequence[ZoneModel]) -> jax.Array:
    """Worlds, bool (C,), in which the zone of some constraint has changed."""
    flags = []
    for c, before, after in zip(constraints, old, new, strict=True):
        flag = ~_law(c).same_zone(before, after)
        if isinstance(c, Coupling):
            flags.append(jnp.any(flag, axis=0))
        else:
            flags += [flag[i] for i in range(flag.shape[0])] if flag.ndim == 2 else [flag]
    return reduce(jnp.logical_or, flags)


def _zones_of_last_step(
    constraints: Sequence[Constraint], zones: Zones, models: Sequence[ZoneModel]
) -> list[ZoneModel]:
    """Zones of the last step for constraints that were active then; `models` for the others."""
    found: list[ZoneModel] = []
    for c, flags, model in zip(constraints, zones, models, strict=True):
        if not flags:
            found.append(model)
            continue
        pushed = reduce(jnp.logical_or, flags)
        pairs = zip(flags, model, strict=True)
        found.append(tuple(jnp.where(pushed, jnp.where(flag, _law(c).weight, 0), x) for flag, x in pairs))
    return found


def constrained_acceleration(
    problem: ConstraintProblem,
    guess: Sequence[jax.Array],
    zones: Zones,
) -> tuple[list[jax.Array], jax.Array, Zones]:
    """The solution of the constraint problem: accelerations per dof, worlds (C,) that did not converge, and its zones.

    The guess is initial accelerations per dof, (C,) or (G, C); zones are those of the last step, all False at the
    first.
    """
    plan, motions, constraints = problem.plan, problem.motions, problem.constraints
    lanes = guess[0].shape[-1]
    if not constraints:
        factors = factorise(plan, motions, problem.inertia.blocks, problem.inertia.diagonal)
        solution, _ = solve_factored(factors, problem.wrenches, problem.tau)
        return [array(x, g.shape, g.dtype) for x, g in zip(solution, guess, strict=True)], jnp.zeros(lanes, bool), []
    search = not all(_law(c).quadratic for c in constraints)

    def shaped(models: Sequence[ZoneModel]) -> list[ZoneModel]:
        shapes = [zone_shape(plan, c, lanes) for c in constraints]
        return [tuple(array(x, s, guess[0].dtype) for x in model) for model, s in zip(models, shapes, strict=True)]

    def body(carry: tuple) -> tuple:
        count, moving, old, models = carry
        x, links = _minimum_on_zones(problem, models, guess)
        a = [array(x_k, g.shape, g.dtype) for x_k, g in zip(x, guess, strict=True)]
        following = shaped(_models(constraints, a, links))
        moved = _zones_changed(constraints, models, following)
        if not search:
            return count + 1, moved, a, following
        # Where the full step keeps its zones it is the solution: the search would find nothing but rounding errors.
        moved = moved & moving
        length = _step_length(problem, old, a, moved)
        a = [jnp.where(moving, y + length * (z - y), y) for y, z in zip(old, a, strict=True)]
        again = shaped(_models(constraints, a, propagate(plan, motions, a)))
        pairs = zip(models, again, strict=True)
        following = [tuple(jnp.where(moved, y, x) for x, y in zip(*pair, strict=True)) for pair in pairs]
        return count + 1, moved & _zones_changed(constraints, models, again), a, following

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < _MAX_NEWTON)

    start = shaped(_models(constraints, guess, propagate(plan, motions, guess)))
    if not search:  # with a line search the zones must be those of the initial accelerations
        start = shaped(_zones_of_last_step(constraints, zones, start))
    carry = (jnp.int32(0), jnp.ones(lanes, bool), list(guess), start)
    # The loop takes most of a step's time: a lower threshold than elsewhere pays, at the cost of compile time.
    _, moved, solution, last = lax.while_loop(searching, retrace(body, threshold=8), carry)
    pushing = [tuple(x != 0 for x in model[: zone_flags(c)]) for c, model in zip(constraints, last, strict=True)]
    return solution, moved, pushing


def _summed(plan: TreePlan, c: Constraint, x: Scalar) -> Scalar:
    """Sum over the members of a constraint's group, or over its slots."""
    if isinstance(c, Coupling):
        return over_slots(x)
    return group_sum(x, plan.dof_size[c.dof] if isinstance(c, DofConstraint) else c.link.size)


def _slopes(c: DofConstraint, start: jax.Array, along: jax.Array) -> Callable[[Scalar], tuple[Scalar, Scalar]]:
    """See `Cone.slopes`."""

    def at(length: Scalar) -> tuple[Scalar, Scalar]:
        here = add(start, mul(length, along))
        stiffness, force = c.effect(c.model(here))
        return mul(along, sub(mul(stiffness, here), force)), mul(stiffness, mul(along, along))

    return at


def _step_length(
    problem: ConstraintProblem, old: Sequence[jax.Array], new: Sequence[jax.Array], wanted: jax.Array
) -> jax.Array:
    """Step lengths (C,), relative to the full step from `old` to `new` accelerations per dof, of the least cost.

    They are 1 in worlds in which none is wanted, bool (C,). The zero of the slope is found by Newton's method with
    bracketing and bisection, starting at the full step.
    """
    plan, constraints, inertia, tau = problem.plan, problem.constraints, problem.inertia, problem.tau
    direction = [y - x for x, y in zip(old, new, strict=True)]
    at, links = propagate(plan, problem.motions, old), propagate(plan, problem.motions, direction)
    slope: Scalar = 0.0
    curve: Scalar = 0.0
    for link, block, a, d, wrench in zip(plan.links, inertia.blocks, at, links, problem.wrenches, strict=True):
        f, n = block @ a
        slope = add(slope, group_sum(generalised_force(d, (vsub(f, wrench[0]), vsub(n, wrench[1]))), link.size))
        curve = add(curve, group_sum(generalised_force(d, block @ d), link.size))
    for k, size in enumerate(plan.dof_size):
        diagonal = inertia.diagonal.get(k, 0.0)
        slope = add(slope, group_sum(mul(direction[k], sub(mul(diagonal, old[k]), tau.get(k, 0.0))), size))
        curve = add(curve, group_sum(mul(diagonal, mul(direction[k], direction[k])), size))
    rays = []
    for c in constraints:
        if isinstance(c, Contact):
            rays.append(c.cone.slopes(c.acceleration(at[c.link.index]), c.acceleration(links[c.link.index])))
        elif isinstance(c, Coupling):
            rays.append(c.cone.slopes(c.acceleration(old), c.acceleration(direction)))
        else:
            rays.append(_slopes(c, old[c.dof], direction[c.dof]))

    def evaluate(length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Slope and curvature of the cost at a step length."""
        first, second = add(slope, mul(length, curve)), curve
        for c, ray in zip(constraints, rays, strict=True):
            own = ray(length)
            first, second = add(first, _summed(plan, c, own[0])), add(second, _summed(plan, c, own[1]))
        lanes = length.shape
        return array(first, lanes, length.dtype), array(second, lanes, length.dtype)

    def newton_step(carry: tuple) -> tuple:
        count, _, length, low, high = carry
        first, second = evaluate(length)
        up = first > 0
        low, high = jnp.where(up, low, length), jnp.where(up, length, high)
        newton = length - first / jnp.where(second > 0, second, 1.0)
        inside = (newton > low) & (newton < high)
        halved = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2.0 * length)
        going = wanted & (jnp.abs(first) > _SLOPE_TOLERANCE * steepest)
        return count + 1, going, jnp.where(going, jnp.where(inside, newton, halved), length), low, high

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < _LINE_ITERATIONS)

    lanes = jnp.ones(old[0].shape[-1], old[0].dtype)
    steepest = jnp.abs(evaluate(0.0 * lanes)[0])
    start = (jnp.int32(0), wanted, lanes, 0.0 * lanes, jnp.inf * lanes)
    return lax.while_loop(searching, newton_step, start)[2]
