"""Newton's method on MuJoCo's convex constraint problem, iterated until the zones of all constraints stay the same.

The cost is quadratic within a zone of the constraints (an active-set method): a full Newton step gives the exact
minimum for the assumed zones, and the solution is found when the zones at that minimum are the assumed ones. Elliptic
cones, whose sliding zone is not quadratic, and dry friction also need a line search.

The first iteration has the zones of the last step, which stay valid until a contact changes, and goes all the way to
their minimum. From there on the inertial forces balance known constraint forces, so that a search along a line needs
the rows of the constraints only.

A world's result does not depend on the other worlds of its chunk: once converged, further iterations reproduce its
solution bit for bit; with a line search the solution is kept.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes_engine.articulated import factorise, solve_factored
from btr_mjx.engines.lanes_engine.constraints.body_contacts import Coupling, over_slots
from btr_mjx.engines.lanes_engine.constraints.cones import ZoneModel
from btr_mjx.engines.lanes_engine.constraints.coupled import solve_coupled
from btr_mjx.engines.lanes_engine.constraints.dof_constraints import DofConstraint
from btr_mjx.engines.lanes_engine.constraints.points import Contact
from btr_mjx.engines.lanes_engine.dynamics import System
from btr_mjx.engines.lanes_engine.kinematics import Motion
from btr_mjx.engines.lanes_engine.spatial import Spatial, propagate
from btr_mjx.engines.lanes_engine.tree import TreePlan
from btr_mjx.engines.rewriting import retrace
from btr_mjx.engines.scalars import (
    Scalar,
    add,
    array,
    dot,
    group_sum,
    sub,
    total,
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


type RowNumbers = list[list[jax.Array]]
"""Per constraint, numbers along its rows, each of the constraint's shape: (C,), (G, C), or (K, C) for K slots."""


def row_shapes(plan: TreePlan, constraints: Sequence[Constraint], lanes: int) -> list[tuple[int, tuple[int, ...]]]:
    """Per constraint, the number of its rows and the shape of their numbers."""
    members = lambda size: () if size == 1 else (size,)  # noqa: E731
    found: list[tuple[int, tuple[int, ...]]] = []
    for c in constraints:
        if isinstance(c, Coupling):
            found.append((c.rows, (c.slots, lanes)))
        else:
            size = plan.dof_size[c.dof] if isinstance(c, DofConstraint) else c.link.size
            found.append((c.cone.rows, (*members(size), lanes)))
    return found


@dataclass(frozen=True)
class _Point:
    """Accelerations at which the cost is looked at."""

    dofs: list[jax.Array]
    short: RowNumbers
    """What the rows fall short of their references, see `Cone`."""


def _point(
    problem: ConstraintProblem, x: Sequence[Scalar], links: Sequence[Spatial], like: Sequence[jax.Array]
) -> _Point:
    """The point of accelerations per dof and of the links that they cause."""
    a = [array(x_k, g.shape, g.dtype) for x_k, g in zip(x, like, strict=True)]
    shapes, short = row_shapes(problem.plan, problem.constraints, a[0].shape[-1]), []
    for c, (count, shape) in zip(problem.constraints, shapes, strict=True):
        along = c.acceleration(links[c.link.index]) if isinstance(c, Contact) else c.acceleration(a)
        own = [sub(r, x_k) for r, x_k in zip(c.cone.reference[:count], along[:count], strict=True)]
        short.append([array(x_k, shape, a[0].dtype) for x_k in own])
    return _Point(a, short)


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


def constrained_acceleration(
    problem: ConstraintProblem, guess: Sequence[jax.Array], last: RowNumbers
) -> tuple[list[jax.Array], jax.Array, RowNumbers]:
    """The solution of the constraint problem: accelerations per dof, worlds (C,) that did not converge, and shortfalls.

    The guess is initial accelerations per dof, (C,) or (G, C). The shortfalls along the rows of all constraints, zero
    where they do not push, are the zones with which the next step begins: `last` is those of the step before.
    """
    plan, motions, constraints = problem.plan, problem.motions, problem.constraints
    lanes = guess[0].shape[-1]
    if not constraints:
        factors = factorise(plan, motions, problem.inertia.blocks, problem.inertia.diagonal)
        solution, _ = solve_factored(factors, problem.wrenches, problem.tau)
        return [array(x, g.shape, g.dtype) for x, g in zip(solution, guess, strict=True)], jnp.zeros(lanes, bool), []
    search = not all(c.cone.quadratic for c in constraints)

    def body(carry: tuple) -> tuple:
        count, moving, a, short, push = carry
        models = [c.cone.model(own) for c, own in zip(constraints, short, strict=True)]
        full = _point(problem, *_minimum_on_zones(problem, models, guess), guess)
        moved = _unsettled(problem, models, full)
        if not search:
            return count + 1, moved, full.dofs, full.short, push
        # Where the full step keeps its zones it is the solution: the search would find nothing but rounding errors.
        moved = moved & moving
        ends = (
            _End(short, push, _forces(constraints, models, short)),
            _End(full.short, _forces(constraints, models, full.short), _forces(constraints, None, full.short)),
        )
        rest = 1.0 - _step_length(constraints, *ends, moved & (count > 0))
        go = lambda x, y: jnp.where(moving, y + rest * (x - y), x)  # noqa: E731
        return count + 1, moved, *jax.tree.map(go, (a, short, push), (full.dofs, full.short, ends[1].balanced))

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < _MAX_NEWTON)

    start = [
        [jnp.where(reduce(jnp.logical_or, [x != 0 for x in before]), x, y) for x, y in zip(before, own, strict=True)]
        for before, own in zip(last, _point(problem, guess, propagate(plan, motions, guess), guess).short, strict=True)
    ]
    push = jax.tree.map(jnp.zeros_like, start) if search else []
    carry = (jnp.int32(0), jnp.ones(lanes, bool), list(guess), start, push)
    # The loop takes most of a step's time: a lower threshold than elsewhere pays, at the cost of compile time.
    _, moved, solution, short, _ = lax.while_loop(searching, retrace(body, threshold=8), carry)
    pushing = [
        [jnp.where(c.cone.force(c.cone.model(own), own)[0] != 0, x, 0) for x in own]
        for c, own in zip(constraints, short, strict=True)
    ]
    return solution, moved, pushing


def _unsettled(problem: ConstraintProblem, models: Sequence[ZoneModel], point: _Point) -> jax.Array:
    """Worlds, bool (C,), in which the forces of some constraint at a point are not those of its zone."""
    flags = []
    for c, model, short in zip(problem.constraints, models, point.short, strict=True):
        flag = ~c.cone.settled(model, short)
        if isinstance(c, Coupling):
            flags.append(jnp.any(flag, axis=0))
        else:
            flags += [flag[i] for i in range(flag.shape[0])] if flag.ndim == 2 else [flag]
    return reduce(jnp.logical_or, flags)


def _forces(constraints: Sequence[Constraint], models: Sequence[ZoneModel] | None, short: RowNumbers) -> RowNumbers:
    """Forces along the rows at shortfalls, in given zones or in those of the shortfalls."""
    found = []
    for n, (c, own) in enumerate(zip(constraints, short, strict=True)):
        force = c.cone.force(models[n] if models else c.cone.model(own), own)
        found.append([array(f, own[0].shape, own[0].dtype) for f in force[: len(own)]])
    return found


@dataclass(frozen=True)
class _End:
    """One end of a line along which the least cost is searched."""

    short: RowNumbers
    """Shortfalls along the rows."""
    balanced: RowNumbers
    """The forces along the rows that balance all other forces."""
    force: RowNumbers
    """The forces of the constraints."""


def _step_length(constraints: Sequence[Constraint], old: _End, new: _End, wanted: jax.Array) -> jax.Array:
    """Step lengths (C,), relative to the full step from an `old` to a `new` end, of the least cost.

    They are 1 in worlds in which none is wanted, bool (C,). The slope of the cost is the product of the shortfalls'
    change and the forces of the constraints minus those that are balanced. Its zero is found by Newton's method with
    bracketing and bisection, starting where the straight line through the slopes at both ends vanishes.
    """
    lanes, dtype = wanted.shape, old.short[0][0].dtype
    along = jax.tree.map(jnp.subtract, new.short, old.short)
    change = jax.tree.map(jnp.subtract, new.balanced, old.balanced)

    def summed(values: Iterable[Scalar]) -> jax.Array:
        """Sum over constraints, and over the members of their groups or over their slots."""
        found = total(
            over_slots(x) if isinstance(c, Coupling) else group_sum(x, d[0].shape[0] if d[0].ndim == 2 else 1)
            for c, d, x in zip(constraints, along, values, strict=True)
        )
        return array(found, lanes, dtype)

    def slope(end: _End) -> jax.Array:
        rows = zip(along, end.force, end.balanced, strict=True)
        return summed(dot(d, vsub(f, b)) for d, f, b in rows)

    first, last = slope(old), slope(new)
    wanted = wanted & (jnp.abs(last) > _SLOPE_TOLERANCE * jnp.abs(first))
    falling = summed(dot(d, f) for d, f in zip(along, old.balanced, strict=True))
    curve = -summed(dot(d, f) for d, f in zip(along, change, strict=True))
    rays = [c.cone.slopes(x, d) for c, x, d in zip(constraints, old.short, along, strict=True)]

    def newton_step(carry: tuple) -> tuple:
        count, _, length, low, high = carry
        one, two = zip(*(ray(length) for ray in rays), strict=True)
        here, second = summed(one) - falling + length * curve, summed(two) + curve
        low, high = jnp.where(here > 0, low, length), jnp.where(here > 0, length, high)
        newton = length - here / jnp.where(second > 0, second, 1.0)
        inside = (newton > low) & (newton < high)
        halved = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2.0 * length)
        going = wanted & (jnp.abs(here) > _SLOPE_TOLERANCE * jnp.abs(first))
        return count + 1, going, jnp.where(going, jnp.where(inside, newton, halved), length), low, high

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < _LINE_ITERATIONS)

    ones = jnp.ones(lanes, dtype)
    up = last > 0
    chord = jnp.clip(first / jnp.where(last > first, first - last, -1.0), 0.0, 2.0)
    begin = (jnp.int32(0), wanted, jnp.where(wanted, chord, 1.0), jnp.where(up, 0, ones), jnp.where(up, ones, jnp.inf))
    return lax.while_loop(searching, newton_step, begin)[2]
