"""Inertia of the links, bias wrenches (Coriolis, centrifugal, gravity), fluid drag, and matrices in factored form.

Fluid drag is that of MuJoCo's inertia-box model (mj_inertiaBoxFluidModel, mjd_inertiaBoxFluid).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp

from btr_mjx.engines.lanes_engine.kinematics import Motion, point_velocity
from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.spatial import Block, Spatial, point_block, rigid_block
from btr_mjx.engines.lanes_engine.tree import BALL, FREE, TreePlan
from btr_mjx.engines.scalars import (
    Matrix,
    Scalar,
    add,
    cross,
    is_zero,
    matmul,
    matvec,
    mul,
    neg,
    sandwich,
    scale,
    total,
    transpose,
    vadd,
    vsub,
)

_NO_COUPLING = [[0.0] * 3] * 3
NO_BLOCK = Block([0.0] * 6, _NO_COUPLING, [0.0] * 6)
"""The zero block."""


@dataclass
class System:
    """A symmetric matrix over dofs in factored form, J^T B J + diag: one block per link and a diagonal over dofs."""

    blocks: list[Block]
    """B, per link, about its origin; it includes the entries of the dofs of a free joint."""
    diagonal: dict[int, Scalar]
    """diag, per dof of other joints; absent entries are zero."""

    def __add__(self, other: "System") -> "System":
        keys = sorted(self.diagonal.keys() | other.diagonal.keys())
        diagonal = {k: add(self.diagonal.get(k, 0.0), other.diagonal.get(k, 0.0)) for k in keys}
        return System([a + b for a, b in zip(self.blocks, other.blocks, strict=True)], diagonal)

    def times(self, factor: Scalar) -> "System":
        """The matrix multiplied by a scalar."""
        return System([b.times(factor) for b in self.blocks], {k: mul(factor, d) for k, d in self.diagonal.items()})

    @property
    def zero(self) -> bool:
        """Whether all entries are known to be zero."""
        return not self.diagonal and all(is_zero(x) for block in self.blocks for x in block.scalars())


def inertia_system(plan: TreePlan, parameters: Parameters, motions: Sequence[Motion]) -> System:
    """Inertia matrix of all links, with armature."""
    blocks = []
    for link, m in zip(plan.links, motions, strict=True):
        h = matvec(m.rotation, parameters[f"{link.index}/h"])
        about = sandwich(m.rotation, parameters[f"{link.index}/inertia"])
        blocks.append(rigid_block(parameters.one(f"{link.index}/mass"), h, about))
    return System(blocks, {}) + dof_system(plan, parameters, motions, "armature")


def bias_wrenches(plan: TreePlan, parameters: Parameters, motions: Sequence[Motion]) -> list[Spatial]:
    """Inertial wrench about each link's origin at zero joint accelerations, minus gravity and its compensation.

    Newton-Euler equations about the origin: with h = sum of m c and the inertia J about the origin, the force is
    m a + alpha x h + w x (w x h) and the torque J alpha + w x J w + h x a.
    """
    found: list[Spatial] = []
    gravity = parameters["world/gravity"]
    for link, m in zip(plan.links, motions, strict=True):
        mass = parameters.one(f"{link.index}/mass")
        h = matvec(m.rotation, parameters[f"{link.index}/h"])
        body = rigid_block(mass, h, sandwich(m.rotation, parameters[f"{link.index}/inertia"]))
        force, torque = body @ (m.acceleration, m.angular_acceleration)
        momentum = rigid_block(0.0, h, body.angular) @ ([0.0] * 3, m.angular_velocity)
        force, torque = (vadd(x, cross(m.angular_velocity, y)) for x, y in zip((force, torque), momentum, strict=True))
        lifted, *lift = parameters[f"{link.index}/lift"]
        found.append((vadd(force, scale(lifted, gravity)), vadd(torque, cross(matvec(m.rotation, lift), gravity))))
    return found


def dof_system(plan: TreePlan, parameters: Parameters, motions: Sequence[Motion], what: str) -> System:
    """A coefficient per dof, "armature" or "damping", as a system."""
    blocks: list[Block] = []
    diagonal: dict[int, Scalar] = {}
    for link, m in zip(plan.links, motions, strict=True):
        block = NO_BLOCK
        for n, joint in enumerate(link.joints):
            values = parameters[f"{link.index}/joint{n}/{what}"]
            if joint.kind == FREE:
                block = Block([*values[:3], 0.0, 0.0, 0.0], _NO_COUPLING, _turned_diagonal(m, values[3:]))
                continue
            diagonal |= {k: value for k, value in zip(joint.dofs, values, strict=True) if not is_zero(value)}
        blocks.append(block)
    return System(blocks, diagonal)


def _turned_diagonal(m: Motion, values: Sequence[Scalar]) -> list[Scalar]:
    """A diagonal matrix in link axes as a symmetric matrix in world axes."""
    if all(isinstance(x, float) and x == values[0] for x in values):
        return [*values, 0.0, 0.0, 0.0]
    return sandwich(m.rotation, [*values, 0.0, 0.0, 0.0])


def local_rates(plan: TreePlan, motions: Sequence[Motion], x: Sequence[Scalar]) -> list[Scalar]:
    """Dof accelerations in MuJoCo's convention: angular accelerations of free and ball joints in link axes."""
    x = _turned(plan, FREE, [transpose(m.rotation) for m in motions], x)
    return _turned(plan, BALL, [transpose(m.axes) for m in motions], x)


def world_rates(plan: TreePlan, motions: Sequence[Motion], x: Sequence[Scalar]) -> list[Scalar]:
    """Dof accelerations along the solver's axes, of free joints those of the world; inverse of `local_rates`."""
    return ball_rates(plan, motions, _turned(plan, FREE, [m.rotation for m in motions], x))


def ball_rates(plan: TreePlan, motions: Sequence[Motion], x: Sequence[Scalar]) -> list[Scalar]:
    """`world_rates` of ball joints, those of free joints as they are."""
    return _turned(plan, BALL, [m.axes for m in motions], x)


def _turned(plan: TreePlan, kind: int, turns: Sequence[Matrix], x: Sequence[Scalar]) -> list[Scalar]:
    result = list(x)
    for link, turn in zip(plan.links, turns, strict=True):
        for joint in link.joints:
            if joint.kind == kind:
                angular = joint.dofs[-3:]
                for k, value in zip(angular, matvec(turn, [x[k] for k in angular]), strict=True):
                    result[k] = value
    return result


def opposing_forces(
    system: System, links: Sequence[Spatial], dofs: Sequence[Scalar]
) -> tuple[list[Spatial], dict[int, Scalar]]:
    """Wrenches per link and forces per dof of minus a system times accelerations (or velocities) of links and dofs."""
    wrenches: list[Spatial] = []
    for block, a in zip(system.blocks, links, strict=True):
        force, torque = block @ a
        wrenches.append((scale(-1.0, force), scale(-1.0, torque)))
    return wrenches, {k: mul(-1.0, mul(d, dofs[k])) for k, d in system.diagonal.items()}


def drag(plan: TreePlan, parameters: Parameters, motions: Sequence[Motion]) -> tuple[list[Spatial], System] | None:
    """Drag of the fluid: wrenches on the links, and minus their derivative by velocity; None in a vacuum."""
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
