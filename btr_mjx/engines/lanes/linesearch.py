"""MuJoCo's convex constraint problem of one step, and exact line search along a Newton direction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes.body_contacts import BodyContacts, over_slots
from btr_mjx.engines.lanes.cones import Contact
from btr_mjx.engines.lanes.dof_constraints import DofConstraint
from btr_mjx.engines.lanes.dynamics import System
from btr_mjx.engines.lanes.kinematics import Motion
from btr_mjx.engines.lanes.scalars import (
    Scalar,
    add,
    array,
    dot,
    full,
    group_sum,
    matvec,
    mul,
    neg,
    scale,
    sub,
    vadd,
    vsub,
)
from btr_mjx.engines.lanes.spatial import Spatial, generalised_force, propagate
from btr_mjx.engines.lanes.tree import TreePlan

_MAX_ITERATIONS = 10
"""Iterations of the line search."""

_SLOPE_TOLERANCE = 1e-3
"""Slope at which the search stops, relative to the slope at its start."""

type Constraint = Contact | BodyContacts | DofConstraint


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


def _summed(plan: TreePlan, c: Constraint, x: Scalar) -> Scalar:
    """Sum over the members of a constraint's group, or over its slots."""
    if isinstance(c, BodyContacts):
        return over_slots(x)
    return group_sum(x, plan.dof_size[c.dof] if isinstance(c, DofConstraint) else c.link.size)


def step_length(problem: ConstraintProblem, old: Sequence[jax.Array], new: Sequence[jax.Array]) -> jax.Array:
    """Step length along the line from `old` through `new` at which the cost is minimal.

    The zero of the slope is found by Newton's method with bracketing and bisection, starting at the full step.

    Args:
      problem: the problem.
      old: accelerations per dof at the start of the step.
      new: accelerations per dof after the full step.

    Returns:
      (C,) step lengths relative to the full step.
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
            rays.append((c.acceleration(at[c.link.index]), c.acceleration(links[c.link.index])))
        elif isinstance(c, BodyContacts):
            rays.append((c.acceleration(old), c.acceleration(direction)))
        else:
            rays.append(([old[c.dof]], [direction[c.dof]]))

    def evaluate(length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Slope and curvature of the cost at a step length."""
        first, second = add(slope, mul(length, curve)), curve
        for c, (start, d) in zip(constraints, rays, strict=True):
            here = vadd(start, scale(length, d))
            if isinstance(c, DofConstraint):
                single, pull = c.effect(c.model(here[0]))
                force, bent = [sub(pull, mul(single, here[0]))], [mul(single, d[0])]
            else:
                stiffness, push = c.cone.linear(c.cone.model(here))
                force, bent = vsub(push, matvec(full(stiffness), here)), matvec(full(stiffness), d)
            first = add(first, _summed(plan, c, neg(dot(force, d))))
            second = add(second, _summed(plan, c, dot(bent, d)))
        lanes = length.shape
        return array(first, lanes, length.dtype), array(second, lanes, length.dtype)

    def newton_step(_: jax.Array, carry: tuple) -> tuple:
        length, low, high = carry
        first, second = evaluate(length)
        up = first > 0
        low, high = jnp.where(up, low, length), jnp.where(up, length, high)
        newton = length - first / jnp.where(second > 0, second, 1.0)
        inside = (newton > low) & (newton < high)
        halved = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2.0 * length)
        better = jnp.where(inside, newton, halved)
        return jnp.where(jnp.abs(first) > _SLOPE_TOLERANCE * steepest, better, length), low, high

    lanes = jnp.ones(old[0].shape[-1], old[0].dtype)
    steepest = jnp.abs(evaluate(0.0 * lanes)[0])
    length, _, _ = lax.fori_loop(0, _MAX_ITERATIONS, newton_step, (lanes, 0.0 * lanes, jnp.inf * lanes))
    return length
