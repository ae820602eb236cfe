"""How far to go along a Newton step: the exact minimum of the convex cost on the way."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes.contacts import Contact
from btr_mjx.engines.lanes.dynamics import System
from btr_mjx.engines.lanes.kinematics import Motion
from btr_mjx.engines.lanes.rows import Row
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
from btr_mjx.engines.lanes.spatial import Spatial, along, propagate
from btr_mjx.engines.lanes.tree import Plan

_TRIALS = 10
_FLAT = 1e-3  # a slope this small relative to the one at the start is zero


def step_length(
    plan: Plan,
    motions: Sequence[Motion],
    constraints: Sequence[Contact | Row],
    inertia: System,
    wrenches: Sequence[Spatial],
    tau: Mapping[int, Scalar],
    old: Sequence[jax.Array],
    new: Sequence[jax.Array],
) -> jax.Array:
    """Fraction of the way from `old` to `new` at which the cost is least, (C,); 1 where the full step is as good.

    The slope along the way is found by Newton's method inside a bracket.

    Args:
      plan: the static plan.
      motions: where the links are.
      constraints: contacts, limits and friction rows.
      inertia: of all links, with armature.
      wrenches: all forces on links but those of the constraints.
      tau: all forces along single dofs but those of the constraints.
      old: accelerations per dof at the start of the step.
      new: accelerations per dof at its end.
    """
    way = [y - x for x, y in zip(old, new, strict=True)]
    at, links = propagate(plan, motions, old), propagate(plan, motions, way)
    slope: Scalar = 0.0
    curve: Scalar = 0.0
    for link, block, a, d, wrench in zip(plan.links, inertia.blocks, at, links, wrenches, strict=True):
        f, n = block @ a
        slope = add(slope, group_sum(along(d, (vsub(f, wrench[0]), vsub(n, wrench[1]))), link.size))
        curve = add(curve, group_sum(along(d, block @ d), link.size))
    for k, size in enumerate(plan.dof_size):
        diagonal = inertia.diagonal.get(k, 0.0)
        slope = add(slope, group_sum(mul(way[k], sub(mul(diagonal, old[k]), tau.get(k, 0.0))), size))
        curve = add(curve, group_sum(mul(diagonal, mul(way[k], way[k])), size))
    rays = []
    for c in constraints:
        if isinstance(c, Contact):
            rays.append((c.acceleration(at[c.link.index]), c.acceleration(links[c.link.index])))
        else:
            rays.append(([old[c.dof]], [way[c.dof]]))

    def evaluate(length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Slope and curvature of the cost along the way."""
        first, second = add(slope, mul(length, curve)), curve
        for c, (start, d) in zip(constraints, rays, strict=True):
            here = vadd(start, scale(length, d))
            size = c.link.size if isinstance(c, Contact) else plan.dof_size[c.dof]
            if isinstance(c, Contact):
                stiffness, push = c.linear(c.model(here))
                force, bent = vsub(push, matvec(full(stiffness), here)), matvec(full(stiffness), d)
            else:
                single, pull = c.effect(c.model(here[0]))
                force, bent = [sub(pull, mul(single, here[0]))], [mul(single, d[0])]
            first = add(first, group_sum(neg(dot(force, d)), size))
            second = add(second, group_sum(dot(bent, d), size))
        lanes = length.shape
        return array(first, lanes, length.dtype), array(second, lanes, length.dtype)

    def improve(_: jax.Array, carry: tuple) -> tuple:
        length, low, high = carry
        first, second = evaluate(length)
        up = first > 0
        low, high = jnp.where(up, low, length), jnp.where(up, length, high)
        newton = length - first / jnp.where(second > 0, second, 1.0)
        inside = (newton > low) & (newton < high)
        halved = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2.0 * length)
        better = jnp.where(inside, newton, halved)
        return jnp.where(jnp.abs(first) > _FLAT * steepest, better, length), low, high

    lanes = jnp.ones(old[0].shape[-1], old[0].dtype)
    steepest = jnp.abs(evaluate(0.0 * lanes)[0])
    length, _, _ = lax.fori_loop(0, _TRIALS, improve, (lanes, 0.0 * lanes, jnp.inf * lanes))
    return length
