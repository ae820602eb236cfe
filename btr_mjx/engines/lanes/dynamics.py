"""Inertia of the links, bias wrenches (Coriolis, centrifugal, gravity), and matrices over dofs in factored form."""

from collections.abc import Sequence
from dataclasses import dataclass

from btr_mjx.engines.lanes.kinematics import Motion
from btr_mjx.engines.lanes.parameters import Parameters
from btr_mjx.engines.lanes.scalars import (
    Matrix,
    Scalar,
    add,
    cross,
    is_zero,
    matvec,
    mul,
    sandwich,
    scale,
    transpose,
    vadd,
)
from btr_mjx.engines.lanes.spatial import Block, Spatial, rigid_block
from btr_mjx.engines.lanes.tree import FREE, TreePlan

_NO_COUPLING = [[0.0] * 3] * 3
NO_BLOCK = Block([0.0] * 6, _NO_COUPLING, [0.0] * 6)
"""The zero block."""


@dataclass
class System:
    """A symmetric matrix over dofs in factored form, J^T B J + diag: one block per link and a diagonal over dofs."""

    blocks: list[Block]
    """B, per link, about its origin; it includes the entries of the dofs of a free joint."""
    diagonal: dict[int, Scalar]
    """diag, per dof of hinges and slides; absent entries are zero."""

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
    """Inertial wrench about each link's origin at zero joint accelerations, minus gravity.

    Newton-Euler equations about the origin: with h = sum of m c and the inertia J about the origin, the force is
    m a + alpha x h + w x (w x h) and the torque J alpha + w x J w + h x a.
    """
    found: list[Spatial] = []
    for link, m in zip(plan.links, motions, strict=True):
        mass = parameters.one(f"{link.index}/mass")
        h = matvec(m.rotation, parameters[f"{link.index}/h"])
        body = rigid_block(mass, h, sandwich(m.rotation, parameters[f"{link.index}/inertia"]))
        force, torque = body @ (m.acceleration, m.angular_acceleration)
        momentum = rigid_block(0.0, h, body.angular) @ ([0.0] * 3, m.angular_velocity)
        found.append(
            (vadd(force, cross(m.angular_velocity, momentum[0])), vadd(torque, cross(m.angular_velocity, momentum[1])))
        )
    return found


def dof_system(plan: TreePlan, parameters: Parameters, motions: Sequence[Motion], what: str) -> System:
    """A coefficient per dof, "armature" or "damping", as a system."""
    blocks, diagonal = [], {}
    for link, m in zip(plan.links, motions, strict=True):
        block = NO_BLOCK
        for n, joint in enumerate(link.joints):
            values = parameters[f"{link.index}/joint{n}/{what}"]
            if joint.kind == FREE:
                block = Block([*values[:3], 0.0, 0.0, 0.0], _NO_COUPLING, _turned_diagonal(m, values[3:]))
            elif not is_zero(values[0]):
                diagonal[joint.dofs[0]] = values[0]
        blocks.append(block)
    return System(blocks, diagonal)


def _turned_diagonal(m: Motion, values: Sequence[Scalar]) -> list[Scalar]:
    """A diagonal matrix in link axes as a symmetric matrix in world axes."""
    if all(isinstance(x, float) and x == values[0] for x in values):
        return [*values, 0.0, 0.0, 0.0]
    return sandwich(m.rotation, [*values, 0.0, 0.0, 0.0])


def local_rates(plan: TreePlan, motions: Sequence[Motion], x: Sequence[Scalar]) -> list[Scalar]:
    """Dof accelerations in MuJoCo's convention: angular accelerations of free joints in link instead of world axes."""
    return _turned_rates(plan, [transpose(m.rotation) for m in motions], x)


def world_rates(plan: TreePlan, motions: Sequence[Motion], x: Sequence[Scalar]) -> list[Scalar]:
    """Dof accelerations with world axes, from MuJoCo's convention; inverse of `local_rates`."""
    return _turned_rates(plan, [m.rotation for m in motions], x)


def _turned_rates(plan: TreePlan, turns: Sequence[Matrix], x: Sequence[Scalar]) -> list[Scalar]:
    result = list(x)
    for link, turn in zip(plan.links, turns, strict=True):
        if link.joints[0].kind == FREE:
            angular = link.joints[0].dofs[3:]
            for k, value in zip(angular, matvec(turn, [x[k] for k in angular]), strict=True):
                result[k] = value
    return result


def opposing_forces(
    system: System, links: Sequence[Spatial], dofs: Sequence[Scalar]
) -> tuple[list[Spatial], dict[int, Scalar]]:
    """Wrenches per link and forces per dof of minus a system times accelerations (or velocities).

    Args:
      system: the matrix, such as inertia or damping.
      links: spatial acceleration (or velocity) of each link.
      dofs: acceleration (or velocity) per dof.
    """
    wrenches: list[Spatial] = []
    for block, a in zip(system.blocks, links, strict=True):
        force, torque = block @ a
        wrenches.append((scale(-1.0, force), scale(-1.0, torque)))
    return wrenches, {k: mul(-1.0, mul(d, dofs[k])) for k, d in system.diagonal.items()}
