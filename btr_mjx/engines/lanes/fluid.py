"""Fluid drag by MuJoCo's inertia-box model (mj_inertiaBoxFluidModel, mjd_inertiaBoxFluid)."""

import math
from collections.abc import Sequence

import jax.numpy as jnp

from btr_mjx.engines.lanes.dynamics import NO_BLOCK, System
from btr_mjx.engines.lanes.kinematics import Motion, point_velocity
from btr_mjx.engines.lanes.parameters import Parameters
from btr_mjx.engines.lanes.scalars import (
    Scalar,
    add,
    cross,
    is_zero,
    matmul,
    matvec,
    mul,
    neg,
    sandwich,
    total,
    transpose,
    vadd,
    vsub,
)
from btr_mjx.engines.lanes.spatial import Block, Spatial, point_block
from btr_mjx.engines.lanes.tree import TreePlan


def drag(plan: TreePlan, parameters: Parameters, motions: Sequence[Motion]) -> tuple[list[Spatial], System] | None:
    """Drag of the fluid on the links.

    Args:
      plan: the static plan.
      parameters: parameters of this chunk.
      motions: poses and velocities of the links.

    Returns:
      Wrenches about the links' origins, and minus their derivative with respect to velocity; None in a vacuum.
    """
    if is_zero(parameters.one("world/density")) and is_zero(parameters.one("world/viscosity")):
        return None
    wrenches: list[Spatial] = []
    blocks: list[Block] = []
    for link, m in zip(plan.links, motions, strict=True):
        force, torque, block = [0.0] * 3, [0.0] * 3, NO_BLOCK
        n = 0
        while (key := f"{link.index}/fluid{n}") + "/box" in parameters:
            (f, t), added = _body(parameters, key, m)
            force, torque, block = vadd(force, f), vadd(torque, t), block + added
            n += 1
        wrenches.append((force, torque))
        blocks.append(block)
    return wrenches, System(blocks, {})


def _body(parameters: Parameters, key: str, m: Motion) -> tuple[Spatial, Block]:
    """Drag of one body, as a box with the same inertia."""
    turn = matmul(m.rotation, parameters.matrix(f"{key}/rot"))
    centre = matvec(m.rotation, parameters[f"{key}/pos"])
    local = transpose(turn)
    flow = matvec(local, vsub(point_velocity(m, centre), parameters["world/wind"]))
    spin = matvec(local, m.angular_velocity)
    linear, angular = _coefficients(parameters, parameters[f"{key}/box"])
    force, stiff = _resist(linear, flow)
    torque, stiff_spin = _resist(angular, spin)
    force, torque = matvec(turn, force), matvec(turn, torque)
    block = point_block(sandwich(turn, [*stiff, 0.0, 0.0, 0.0]), centre)
    block = block + Block([0.0] * 6, [[0.0] * 3] * 3, sandwich(turn, [*stiff_spin, 0.0, 0.0, 0.0]))
    return (force, vadd(torque, cross(centre, force))), block


def _resist(
    coefficients: Sequence[tuple[Scalar, Scalar]], speed: Sequence[Scalar]
) -> tuple[list[Scalar], list[Scalar]]:
    """Force -(c1 s + c2 |s| s) along each axis, and minus its derivative."""
    force, slope = [], []
    for (viscous, quadratic), s in zip(coefficients, speed, strict=True):
        pressed = mul(quadratic, 0.0 if is_zero(s) else jnp.abs(s))
        force.append(neg(mul(add(viscous, pressed), s)))
        slope.append(add(viscous, mul(2.0, pressed)))
    return force, slope


def _coefficients(
    parameters: Parameters, box: Sequence[Scalar]
) -> tuple[list[tuple[Scalar, Scalar]], list[tuple[Scalar, Scalar]]]:
    """Viscous and quadratic coefficients, linear then angular, along the three axes of a box of edges `box` [m]."""
    density, viscosity = parameters.one("world/density"), parameters.one("world/viscosity")
    diameter = mul(1.0 / 3.0, total(box))
    linear, angular = [], []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        area = mul(box[j], box[k])
        fourth = add(*(mul(mul(b, b), mul(b, b)) for b in (box[j], box[k])))
        cube = mul(diameter, mul(diameter, diameter))
        linear.append((mul(mul(3.0 * math.pi, diameter), viscosity), mul(mul(0.5, area), density)))
        angular.append((mul(mul(math.pi, cube), viscosity), mul(mul(mul(1 / 64, box[i]), fourth), density)))
    return linear, angular
