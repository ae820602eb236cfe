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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.guards.placed_geoms import fold_rows
from btr_mjx.engines.lanes_engine.articulated import factorise, solve_factored
from btr_mjx.engines.lanes_engine.constraints.body_contacts import Coupling, over_slots
from btr_mjx.engines.lanes_engine.constraints.coupled import solve_coupled
from btr_mjx.engines.lanes_engine.constraints.dof_constraints import DofConstraint
from btr_mjx.engines.lanes_engine.constraints.points import Contact, Points
from btr_mjx.engines.lanes_engine.dynamics import System
from btr_mjx.engines.lanes_engine.kinematics import Motion
from btr_mjx.engines.lanes_engine.spatial import Block, Spatial, propagate
from btr_mjx.engines.lanes_engine.tree import TreePlan
from btr_mjx.engines.rewriting import retrace
from btr_mjx.engines.scalars import Scalar, add, array, dot, group_sum, sub, total, vsub

_MAX_NEWTON = 20
"""Iterations of a step."""

_LINE_ITERATIONS = 10
"""Iterations of the line search."""

_SLOPE_TOLERANCE = 1e-3
"""Slope at which the search stops, relative to the slope at its start."""

type Constraint = Points | Coupling | DofConstraint
type _Single = Contact | Coupling | DofConstraint


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
"""Per constraint, numbers along its rows: (C,) or (G, C) of a dof, (P, C) or (P, G, C) of points, (K, C) of slots."""


def row_shapes(plan: TreePlan, constraints: Sequence[Constraint], lanes: int) -> list[tuple[int, tuple[int, ...]]]:
    """Per constraint, the number of its rows and the shape of their numbers."""
    members = lambda size: () if size == 1 else (size,)  # noqa: E731
    found: list[tuple[int, tuple[int, ...]]] = []
    for c in constraints:
        if isinstance(c, Coupling):
            found.append((c.rows, (c.slots, lanes)))
        elif isinstance(c, DofConstraint):
            found.append((c.cone.rows, (*members(plan.dof_size[c.dof]), lanes)))
        else:
            found.append((c.rows, (c.count, *members(c.link.size), lanes)))
    return found


def _quadratic(c: Constraint) -> bool:
    return c.quadratic if isinstance(c, Points) else c.cone.quadratic


@dataclass(frozen=True)
class _Reached:
    """Accelerations of dofs and links."""

    dofs: list[jax.Array]
    links: Sequence[Spatial]

    def short(self, c: _Single, like: jax.Array) -> list[jax.Array]:
        """What the accelerations along the rows of a constraint fall short of their references, see `Cone`."""
        along = c.acceleration(self.links[c.link.index]) if isinstance(c, Contact) else c.acceleration(self.dofs)
        rows = c.rows if isinstance(c, Coupling) else c.cone.rows
        return [
            array(sub(r, x), like.shape, like.dtype) for r, x in zip(c.cone.reference[:rows], along[:rows], strict=True)
        ]


def _each[T](
    c: Constraint,
    one: Callable[..., tuple[RowNumbers, list[Scalar]]],
    given: Sequence[list[jax.Array]],
    made: RowNumbers,
    sums: list,
) -> tuple[RowNumbers, list[Scalar]]:
    """The rows that `one` makes of a constraint and given rows, and what it adds to sums; of points those that touch.

    RowNumbers of the other points are those of `made`.
    """
    if not isinstance(c, Points):
        return one(c, *given)

    def visit(p: jax.Array, point: Contact, carry: tuple) -> tuple:
        rows, so_far = carry
        own = [[lax.dynamic_index_in_dim(x, p, keepdims=False) for x in row] for row in given]
        new, more = one(point, *own)
        rows = jax.tree.map(lambda x, y: lax.dynamic_update_index_in_dim(x, y, p, 0), rows, new)
        both = zip(so_far, more, strict=True)
        return rows, [x | y if x.dtype == bool else x + y for x, y in both]

    return c.visit(visit, (made, sums))


def _whole(c: Constraint, x: jax.Array) -> jax.Array:
    """Sum, or for bools whether any is true, over the members of a constraint's group or over its slots, (C,)."""
    if x.dtype == bool:
        return fold_rows(jnp.logical_or, x) if x.ndim == 2 else x
    return over_slots(x) if isinstance(c, Coupling) else group_sum(x, x.shape[0] if x.ndim == 2 else 1)


def _minimum_on_zones(problem: ConstraintProblem, short: RowNumbers, like: Sequence[jax.Array]) -> _Reached:
    """Minimum of the cost for the zones of given shortfalls, where it is quadratic."""
    blocks, outer = list(problem.inertia.blocks), list(problem.wrenches)
    diagonal, forces = dict(problem.inertia.diagonal), dict(problem.tau)
    couplings = []
    for c, own in zip(problem.constraints, short, strict=True):
        if isinstance(c, Coupling):
            couplings.append((c, c.cone.model(own)))
        elif isinstance(c, DofConstraint):
            stiffness, push = c.effect(c.cone.model(own))
            diagonal[c.dof] = add(diagonal.get(c.dof, 0.0), stiffness)
            forces[c.dof] = add(forces.get(c.dof, 0.0), push)
        else:
            at = c.link.index
            so_far = (*blocks[at].scalars(), *outer[at][0], *outer[at][1])

            def effect(point: Contact, rows: list[jax.Array]) -> tuple[RowNumbers, list[Scalar]]:
                block, (force, torque) = point.effect(point.cone.model(rows))
                return [], [*block.scalars(), *force, *torque]

            begin = [array(x, own[0].shape[1:], own[0].dtype) for x in so_far]
            _, found = _each(c, effect, [own], [], begin)
            blocks[at], outer[at] = Block.of(found[:21]), (found[21:24], found[24:])
    factors = factorise(problem.plan, problem.motions, blocks, diagonal)
    if couplings:
        x, links = solve_coupled(factors, couplings, outer, forces, like)
    else:
        x, links = solve_factored(factors, outer, forces)
    return _Reached([array(x_k, g.shape, g.dtype) for x_k, g in zip(x, like, strict=True)], links)


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
    search = not all(map(_quadratic, constraints))

    def body(carry: tuple) -> tuple:
        count, moving, a, short, push = carry
        full = _minimum_on_zones(problem, short, guess)
        moved, slopes, made = _looked_at(constraints, full, short, push)
        if not search:
            return count + 1, moved, full.dofs, [new for (new,) in made], push
        # Where the full step keeps its zones it is the solution: the search would find nothing but rounding errors.
        moved = moved & moving
        ends = list(zip(short, push, *zip(*made, strict=True), strict=True))
        rest = 1.0 - _step_length(constraints, ends, slopes, moved & (count > 0))
        go = lambda x, y: jnp.where(moving, y + rest * (x - y), x)  # noqa: E731

        def gone(_: _Single, short: list, push: list, *new: list[jax.Array]) -> tuple[RowNumbers, list[Scalar]]:
            return jax.tree.map(go, [short, push], list(new)), []

        found = [_each(c, gone, end, list(end[:2]), [])[0] for c, end in zip(constraints, ends, strict=True)]
        short, push = ([rows[k] for rows in found] for k in range(2))
        return count + 1, moved, jax.tree.map(go, a, full.dofs), short, push

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < _MAX_NEWTON)

    begin = _Reached(list(guess), propagate(plan, motions, guess))

    def start(c: _Single, before: list[jax.Array]) -> tuple[RowNumbers, list[Scalar]]:
        known = reduce(jnp.logical_or, [x != 0 for x in before])
        return [[jnp.where(known, x, y) for x, y in zip(before, begin.short(c, before[0]), strict=True)]], []

    def end(c: _Single, own: list[jax.Array]) -> tuple[RowNumbers, list[Scalar]]:
        pushes = c.cone.force(c.cone.model(own), own)[0] != 0
        return [[jnp.where(pushes, x, 0) for x in own]], []

    nothing = jax.tree.map(jnp.zeros_like, last)
    mapped = lambda one, rows: [  # noqa: E731
        _each(c, one, [own], [none], [])[0][0] for c, own, none in zip(constraints, rows, nothing, strict=True)
    ]
    carry = (jnp.int32(0), jnp.ones(lanes, bool), list(guess), mapped(start, last), nothing if search else [])
    # The loop takes most of a step's time: a lower threshold than elsewhere pays, at the cost of compile time.
    _, moved, solution, short, _ = lax.while_loop(searching, retrace(body, threshold=8), carry)
    return solution, moved, mapped(end, short)


def _looked_at(
    constraints: Sequence[Constraint], full: _Reached, short: RowNumbers, push: RowNumbers
) -> tuple[jax.Array, list[jax.Array], list[RowNumbers]]:
    """What the constraints say of a full step from shortfalls at which the rows balance other forces with `push`.

    These are worlds, bool (C,), in which the forces of some constraint are not those of its zone; and with a search
    four sums (C,) along the change of the shortfalls: the slope of the cost at both ends, `push`, and its change. Last
    the shortfalls of each constraint at the end of the step, and with a search the forces that are balanced there.
    """

    def look(c: _Single, old: list[jax.Array], held: list[jax.Array] | None = None) -> tuple[RowNumbers, list[Scalar]]:
        new, model = full.short(c, old[0]), c.cone.model(old)
        moved = jnp.broadcast_to(~c.cone.settled(model, new), old[0].shape)
        if held is None:
            return [new], [moved]
        before, balanced, after = (
            [array(x, old[0].shape, old[0].dtype) for x in force[: len(old)]]
            for force in (c.cone.force(model, old), c.cone.force(model, new), c.cone.force(c.cone.model(new), new))
        )
        along = vsub(new, old)
        sums = (vsub(before, held), vsub(after, balanced), held, vsub(balanced, held))
        return [new, balanced], [moved, *(dot(along, x) for x in sums)]

    flags, totals, rows = [], [], []
    for n, (c, own) in enumerate(zip(constraints, short, strict=True)):
        given = [own, push[n]] if push else [own]
        none = jnp.zeros_like(own[0][0] if isinstance(c, Points) else own[0])
        made, (moved, *sums) = _each(c, look, given, given, [none != 0, *[none] * (4 if push else 0)])
        flags.append(_whole(c, moved))
        totals.append([_whole(c, x) for x in sums])
        rows.append(made)
    return reduce(jnp.logical_or, flags), [total(x) for x in zip(*totals, strict=True)], rows


def _step_length(
    constraints: Sequence[Constraint],
    ends: Sequence[Sequence[list[jax.Array]]],
    slopes: Sequence[jax.Array],
    wanted: jax.Array,
) -> jax.Array:
    """Step lengths (C,), relative to the full step, of the least cost; 1 in worlds in which none is wanted, bool (C,).

    Per constraint, `ends` has the shortfalls and the balanced forces at the beginning, and the same at the end; slopes
    are as of `_looked_at`. The zero of the slope is found by Newton's method with bracketing and bisection, starting
    where the straight line through the slopes at both ends vanishes.
    """
    first, last, held, change = slopes
    wanted = wanted & (jnp.abs(last) > _SLOPE_TOLERANCE * jnp.abs(first))

    def newton_step(carry: tuple) -> tuple:
        count, _, length, low, high = carry

        def ray(c: _Single, old: list, _: list, new: list, __: list) -> tuple[RowNumbers, list[Scalar]]:
            return [], [*c.cone.slopes(old, vsub(new, old))(length)]

        here, second = -held - length * change, -change
        for c, end in zip(constraints, ends, strict=True):
            none = jnp.zeros_like(end[0][0][0] if isinstance(c, Points) else end[0][0])
            _, found = _each(c, ray, end, [], [none, none])
            here, second = here + _whole(c, found[0]), second + _whole(c, found[1])
        low, high = jnp.where(here > 0, low, length), jnp.where(here > 0, length, high)
        newton = length - here / jnp.where(second > 0, second, 1.0)
        inside = (newton > low) & (newton < high)
        halved = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2.0 * length)
        going = wanted & (jnp.abs(here) > _SLOPE_TOLERANCE * jnp.abs(first))
        return count + 1, going, jnp.where(going, jnp.where(inside, newton, halved), length), low, high

    def searching(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < _LINE_ITERATIONS)

    ones, up = jnp.ones_like(first), last > 0
    chord = jnp.clip(first / jnp.where(last > first, first - last, -1.0), 0.0, 2.0)
    begin = (jnp.int32(0), wanted, jnp.where(wanted, chord, 1.0), jnp.where(up, 0, ones), jnp.where(up, ones, jnp.inf))
    return lax.while_loop(searching, newton_step, begin)[2]
