"""Conjugate gradients for constraints that couple links: minimum of the cost on given zones.

Constraints of single links and dofs keep the matrix H of the tree, which the articulated-body sweep solves directly.
Those between links add J^T K J, of low rank because few pairs touch at a time. Conjugate gradients with H as the
preconditioner need about as many iterations as there are active rows, and none where nothing touches. All residuals
are J^T times forces of the pairs, so that only these forces are kept.

Source: Saad 2003, Iterative Methods for Sparse Linear Systems, algorithm 9.1.
"""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes.articulated import Factors, solve_factored
from btr_mjx.engines.lanes.body_contacts import BodyContacts, Member
from btr_mjx.engines.lanes.cones import ZoneModel
from btr_mjx.engines.lanes.scalars import Scalar, array, dot, full, matvec, vadd
from btr_mjx.engines.lanes.spatial import Spatial, propagate

_MAX_ITERATIONS = 60

type _Rows = list[list[jax.Array]]
"""Per group of contacts, its rows (K, C)."""


def solve_coupled(
    factors: Factors,
    coupled: Sequence[tuple[BodyContacts, ZoneModel]],
    wrenches: Sequence[Spatial],
    tau: Mapping[int, Scalar],
    like: Sequence[jax.Array],
) -> tuple[list[Scalar], list[Spatial]]:
    """Accelerations of dofs and links.

    Args:
      factors: matrix of the tree, with the constraints of single links and dofs.
      coupled: contacts between links, each with its zone.
      wrenches: per link, about its origin, without those of the couplings.
      tau: forces along single dofs.
      like: arrays of the accelerations' shapes.

    Returns:
      Acceleration per dof, spatial acceleration per link. They are a function of the zones of each world alone.
    """
    plan = factors.plan
    sizes = [link.size for link in plan.links]
    couplings, linear = [c for c, _ in coupled], [c.cone.linear(model) for c, model in coupled]
    lanes, dtype = like[0].shape[-1], like[0].dtype
    tolerance = float(jnp.finfo(dtype).eps) ** 2

    def pushed(forces: Sequence[Sequence[Scalar]], onto: Sequence[Spatial]) -> list[Spatial]:
        return add_wrenches(onto, sizes, [w for c, f in zip(couplings, forces, strict=True) for w in c.wrenches(f)])

    def shaped(rows: Sequence[Sequence[Scalar]]) -> _Rows:
        return [
            [array(x, (c.slots, lanes), dtype) for x in own[: c.rows]] for c, own in zip(couplings, rows, strict=True)
        ]

    def stiff(rows: _Rows) -> _Rows:
        """K times rows."""
        return shaped([matvec(full(k), [*own, 0.0, 0.0][:3]) for (k, _), own in zip(linear, rows, strict=True)])

    def inner(a: _Rows, b: _Rows) -> jax.Array:
        return sum((jnp.sum(dot(x, y), axis=0) for x, y in zip(a, b, strict=True)), jnp.zeros(lanes, dtype))

    def mixed(a: _Rows, length: jax.Array, b: _Rows) -> _Rows:
        return [[x + length * y for x, y in zip(*pair, strict=True)] for pair in zip(a, b, strict=True)]

    nothing: list[Spatial] = [([0.0] * 3, [0.0] * 3) for _ in sizes]
    x, links = solve_factored(factors, pushed([push for _, push in linear], wrenches), tau)
    start = [array(x_k, g.shape, dtype) for x_k, g in zip(x, like, strict=True)]
    residual = [[-y for y in own] for own in stiff(shaped([c.acceleration(links) for c in couplings]))]
    still, empty = jax.tree.map(jnp.zeros_like, (start, residual))

    def body(carry: tuple) -> tuple:
        count, going, x, residual, p, rows, image, last, first = carry
        z, links = solve_factored(factors, pushed(residual, nothing), {})
        moved = shaped([c.acceleration(links) for c in couplings])
        size = inner(residual, moved)
        first = jnp.where(count == 0, size, first)
        going = going & (size > tolerance * first)
        back = jnp.where(count == 0, 0, size / jnp.where(last > 0, last, 1))
        p = [array(z_k, p_k.shape, dtype) + back * p_k for z_k, p_k in zip(z, p, strict=True)]
        rows, image = mixed(moved, back, rows), mixed(residual, back, image)
        applied = mixed(image, jnp.ones(lanes, dtype), stiff(rows))
        curve = inner(rows, applied)
        length = jnp.where(going & (curve > 0), size / jnp.where(curve > 0, curve, 1), 0)
        x = [x_k + length * p_k for x_k, p_k in zip(x, p, strict=True)]
        return count + 1, going, x, mixed(residual, -length, applied), p, rows, image, size, first

    def working(carry: tuple) -> jax.Array:
        return jnp.any(carry[1]) & (carry[0] < _MAX_ITERATIONS)

    none = jnp.zeros(lanes, dtype)
    going = jnp.any(jnp.stack([jnp.any(x != 0, axis=0) for own in residual for x in own]), axis=0)
    carry = (jnp.int32(0), going, start, residual, still, empty, empty, none, none)
    found = lax.while_loop(working, body, carry)[2]
    return list(found), propagate(plan, factors.motions, found)


def add_wrenches(
    links: Sequence[Spatial], sizes: Sequence[int], more: Sequence[tuple[Member, list[jax.Array]]]
) -> list[Spatial]:
    """Wrenches of links, with further ones of single members of their groups added.

    Args:
      links: wrench per link.
      sizes: members of each link's group.
      more: link and member, and six arrays (C,).
    """
    parts: dict[int, dict[int, list[Scalar]]] = {}
    for (link, which), six in more:
        known = parts.setdefault(link, {})
        known[which] = vadd(known[which], six) if which in known else six
    found = list(links)
    for link, known in parts.items():
        nothing = [jnp.zeros_like(x) for x in next(iter(known.values()))]
        members = [known.get(which, nothing) for which in range(sizes[link])]
        six = [jnp.stack(column) if sizes[link] > 1 else column[0] for column in zip(*members, strict=True)]
        found[link] = vadd(found[link][0], six[:3]), vadd(found[link][1], six[3:])
    return found
