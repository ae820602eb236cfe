"""Constraints on a single dof: joint limits and dry friction (mj_instantiateLimit, mj_instantiateFriction)."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from btr_mjx.engines.lanes_engine.constraints.cones import (
    Cone,
    DryFriction,
    Frictionless,
    ZoneModel,
    constraint_law,
)
from btr_mjx.engines.lanes_engine.kinematics import axis_angle, unit_quaternion
from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.tree import BALL, FREE, TreePlan
from btr_mjx.engines.scalars import Scalar, mul, neg, sub


@dataclass
class DofConstraint:
    """A constraint on one dof, of one row."""

    dof: int
    sign: float
    """+1 where the row is the dof's acceleration, -1 where it is minus that."""
    cone: Cone

    def acceleration(self, a: Sequence[Scalar]) -> list[Scalar]:
        """Acceleration along the row, from that of the dofs."""
        return [mul(self.sign, a[self.dof]), 0.0, 0.0]

    def effect(self, model: ZoneModel) -> tuple[Scalar, Scalar]:
        """Stiffness and force of a zone: the force along the dof at acceleration `a` is force - stiffness a."""
        return self.cone.stiffness(model)[0], mul(self.sign, self.cone.force(model, self.cone.reference)[0])


def dof_constraints(
    plan: TreePlan, parameters: Parameters, q: Sequence[Sequence[jax.Array]], v: Sequence[jax.Array]
) -> list[DofConstraint]:
    """All joint limits and dry frictions of a chunk; limits that are not violated have weight zero.

    Coordinates are per joint, velocities per dof along the solver's axes.
    """
    found: list[DofConstraint] = []
    coordinates = iter(q)
    for link in plan.links:
        for n, joint in enumerate(link.joints):
            here = next(coordinates)
            key = f"{link.index}/joint{n}"
            if joint.kind == FREE:
                continue
            if joint.friction and not joint.turned:
                rows = (parameters[f"{key}/{name}"] for name in ("loss", "loss_weight", "loss_damping"))
                for dof, loss, weight, damping in zip(joint.dofs, *rows, strict=True):
                    reference = mul(neg(damping), v[dof])
                    weight = mul(weight, jnp.ones_like(v[dof]))
                    found.append(DofConstraint(dof, 1.0, DryFriction([], [], weight, [reference, 0.0, 0.0], loss)))
            if joint.limited and joint.kind == BALL:
                _, angle = axis_angle(unit_quaternion(here))
                distance = sub(parameters.one(f"{key}/range"), angle)
                found.append(_limit(parameters, key, joint.dofs[0], -1.0, distance, v[joint.dofs[0]]))
            elif joint.limited:
                dof, (lower, upper) = joint.dofs[0], parameters[f"{key}/range"]
                for sign, distance in ((1.0, sub(here[0], lower)), (-1.0, sub(upper, here[0]))):
                    found.append(_limit(parameters, key, dof, sign, distance, v[dof]))
    return found


def _limit(parameters: Parameters, key: str, dof: int, sign: float, distance: Scalar, v: jax.Array) -> DofConstraint:
    """One side of a range; +1 for the lower: the constraint pushes towards positive velocity."""
    beyond = sub(distance, parameters.one(f"{key}/limit_margin"))
    strength, reference = constraint_law(parameters, f"{key}/limit_", beyond, mul(sign, v))
    cone = Frictionless([], [], jnp.where(beyond < 0, strength, 0), [reference, 0.0, 0.0])
    return DofConstraint(dof, sign, cone)
