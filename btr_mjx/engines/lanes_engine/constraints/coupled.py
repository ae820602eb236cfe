"""Conjugate gradients for constraints that couple links: minimum of the cost on given zones.

Constraints of single links and dofs keep the matrix H of the tree, which the articulated-body sweep solves directly.
Those between links add J^T K J, of low rank because few pairs touch at a time and few joints are coupled. Conjugate
gradients with H as the preconditioner need about as many iterations as there are active rows, and one where none is
active. All residuals are J^T times forces of these constraints, so that only the forces are kept.

Source: Saad 2003, Iterative Methods for Sparse Linear Systems, algorithm 9.1.
"""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.guards.placed_geoms import fold_rows
from btr_mjx.engines.lanes_engine.articulated import Factors, solve_factored
from btr_mjx.engines.lanes_engine.constraints.body_contacts import Column, Coupling, over_slots
from btr_mjx.engines.lanes_engine.constraints.cones import ZoneModel
from btr_mjx.engines.lanes_engine.spatial import Spatial, propagate
from btr_mjx.engines.lanes_engine.tree import FREE, TreePlan
from btr_mjx.engines.scalars import Scalar, add, array, dot, full, is_zero, matvec, padded, total, vadd

_MAX_ITERATIONS = 60

_ROUNDINGS = 10
"""Units of rounding to which the residual falls, relative to the first: errors of a step do not shrink below."""

type _Rows = list[list[jax.Array]]
"""Per coupling, its rows (K, C)."""


def solve_coupled(
    factors: Factors,
    coupled: Sequence[tuple[Coupling, ZoneModel]],
    wrenches: Sequence[Spatial],
    tau: Mapping[int, Scalar],
    like: Sequence[jax.Array],
) -> tuple[list[Scalar], list[Spatial]]:
    """Acceleration per dof and spatial acceleration per link, as a function of the zones of each world alone.

    `factors` hold the constraints of single links and dofs; wrenches and forces are without those of constraints
    between links, `coupled`, each with its zone. `like` has arrays of the accelerations' shapes.
    """
    plan = factors.plan
    couplings = [c for c, _ in coupled]
    linear = [(c.cone.stiffness(model), c.cone.force(model, c.cone.reference)) for c, model in coupled]
    lanes, dtype = like[0].shape[-1], like[0].dtype
    tolerance = (_ROUNDINGS * float(jnp.finfo(dtype).eps)) ** 2

    def pulled(rows: Sequence[Sequence[Scalar]]) -> tuple[dict[int, Spatial], dict[int, Scalar]]:
        return member_forces(plan, [w for c, own in zip(couplings, rows, strict=True) for w in c.forces(own)])

    def shaped(rows: Sequence[Sequence[Scalar]]) -> _Rows:
        return [
            [array(x, (c.slots, lanes), dtype) for x in own[: c.rows]] for c, own in zip(couplings, rows, strict=True)
        ]

    def stiff(rows: _Rows) -> _Rows:
        """K times rows."""
        return shaped([matvec(full(k), padded(own, 3)) for (k, _), own in zip(linear, rows, strict=True)])

    def inner(a: _Rows, b: _Rows) -> jax.Array:
        return array(total(over_slots(dot(x, y)) for x, y in zip(a, b, strict=True)), (lanes,), dtype)

    def mixed(a: _Rows, length: Scalar, b: _Rows) -> _Rows:
        return [[x + length * y for x, y in zip(*pair, strict=True)] for pair in zip(a, b, strict=True)]

    def body(carry: tuple) -> tuple:
        count, going, x, residual, p, rows, image, last, first = carry
        # The first iteration solves without the constraints between links, the others correct it. If it had their
        # forces at zero acceleration, rounding errors would grow with the square of the stiffness.
        begins = jnp.broadcast_to(count == 0, lanes)
        begin = lambda value: value if is_zero(value) else jnp.where(begins, value, 0)  # noqa: E731
        onwards = lambda rows: [[jnp.where(begins, 0, y) for y in own] for own in rows]  # noqa: E731
        outer, forces = pulled(onwards(residual))
        onto = [([begin(y) for y in force], [begin(y) for y in torque]) for force, torque in wrenches]
        for n, (force, torque) in outer.items():
            onto[n] = vadd(onto[n][0], force), vadd(onto[n][1], torque)
        along = {k: begin(t) for k, t in tau.items()}
        along |= {k: add(along.get(k, 0.0), f) for k, f in forces.items()}
        z, _ = solve_factored(factors, onto, along)
        z = [array(z_k, g.shape, dtype) for z_k, g in zip(z, like, strict=True)]
        moved = shaped([c.acceleration(z) for c in couplings])
        size = inner(residual, moved)
        first = jnp.where(count == 1, size, first)
        going = going & ((count < 2) | (size > tolerance * first))
        back = jnp.where(count <= 1, 0, size / jnp.where(last > 0, last, 1))
        p = [z_k + back * p_k for z_k, p_k in zip(z, p, strict=True)]
        rows, image = mixed(moved, back, rows), onwards(mixed(residual, back, image))
        applied = mixed(image, 1.0, stiff(rows))
        curve = inner(rows, applied)
        length = jnp.where(going & (curve > 0), size / jnp.where(curve > 0, curve, 1), 0)
        length = jnp.where(count == 0, 1, length)
        x = [x_k + length * p_k for x_k, p_k in zip(x, p, strict=True)]
        residual = mixed(residual, -length, applied)
        going = going & fold_rows(jnp.logical_or, jnp.concatenate([y != 0 for own in residual for y in own]))
        return count + 1, going, x, residual, p, rows, image, size, first

    def working(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < _MAX_ITERATIONS)

    none, still = jnp.zeros(lanes, dtype), [jnp.zeros_like(g) for g in like]
    empty = shaped([[0.0] * c.rows for c in couplings])
    pushes = shaped([push for _, push in linear])
    carry = (jnp.int32(0), jnp.ones(lanes, bool), still, pushes, still, empty, empty, none, none)
    found = lax.while_loop(working, body, carry)[2]
    return list(found), propagate(plan, factors.motions, found)


def member_forces(
    plan: TreePlan, forces: Sequence[tuple[Column, Scalar]]
) -> tuple[dict[int, Spatial], dict[int, Scalar]]:
    """Forces (C,) along dofs of members of groups, added up as forces along dofs of the plan.

    Per link with a free joint this is a wrench about its origin; per other dof a force, (C,) or (G, C).
    """
    parts: dict[int, dict[int, Scalar]] = {}
    for column, force in forces:
        own = parts.setdefault(column.dof, {})
        own[column.member] = add(own.get(column.member, 0.0), force)
    tau: dict[int, Scalar] = {}
    for dof, own in parts.items():
        size = plan.dof_size[dof]
        nothing = jnp.zeros_like(next(iter(own.values())))
        tau[dof] = jnp.stack([own.get(n, nothing) for n in range(size)]) if size > 1 else own[0]
    wrenches: dict[int, Spatial] = {}
    for link in plan.links:
        if link.joints[0].kind == FREE and any(k in tau for k in link.dofs):
            six = [tau.pop(k, 0.0) for k in link.dofs]
            wrenches[link.index] = six[:3], six[3:]
    return wrenches, tau
