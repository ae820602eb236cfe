"""Constraints on a single dof: joint limits and dry friction (mj_instantiateLimit, mj_instantiateFriction)."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import ClassVar

import jax
import jax.numpy as jnp

from btr_mjx.engines.lanes_engine.constraints.cones import ZoneModel, constraint_law
from btr_mjx.engines.lanes_engine.kinematics import axis_angle, unit_quaternion
from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.tree import BALL, FREE, TreePlan
from btr_mjx.engines.scalars import Scalar, add, mul, neg, sub


class DofConstraint(ABC):
    """A constraint on one dof."""

    dof: int
    weight: Scalar
    flags: ClassVar[int] = 0
    """See `Cone.flags`."""
    quadratic: ClassVar[bool] = True
    """See `Cone.quadratic`."""

    @abstractmethod
    def model(self, a: jax.Array) -> ZoneModel:
        """Zone at joint acceleration `a`."""

    @abstractmethod
    def effect(self, model: ZoneModel) -> tuple[Scalar, Scalar]:
        """Stiffness and force of a zone: the force along the dof at acceleration `a` is force - stiffness a."""

    def same_zone(self, old: ZoneModel, new: ZoneModel) -> jax.Array:
        """Whether two zones are the same."""
        return reduce(jnp.logical_and, [x == y for x, y in zip(old, new, strict=True)])


@dataclass
class Limit(DofConstraint):
    """One side of a joint's range, active where `weight` is not zero."""

    dof: int
    sign: float
    """+1 for the lower side: the constraint pushes towards positive velocity."""
    weight: Scalar
    reference: Scalar
    flags: ClassVar[int] = 1

    def model(self, a: jax.Array) -> ZoneModel:
        """Weight of the row if it is active at joint acceleration `a`, else zero."""
        return (jnp.where(sub(mul(self.sign, a), self.reference) < 0, self.weight, 0),)

    def effect(self, model: ZoneModel) -> tuple[Scalar, Scalar]:
        """See `DofConstraint.effect`."""
        return model[0], mul(self.sign, mul(model[0], self.reference))


@dataclass
class Friction(DofConstraint):
    """Friction loss of a dof: a force that opposes motion, bounded by `loss`."""

    dof: int
    loss: Scalar
    weight: Scalar
    reference: Scalar
    quadratic: ClassVar[bool] = False

    def model(self, a: jax.Array) -> ZoneModel:
        """Stiffness and force: a stiff damper within the bound (sticking), a constant force outside (slipping)."""
        jar = sub(a, self.reference)
        pull = mul(self.weight, jar)
        sticks = (sub(pull, self.loss) < 0) & (add(pull, self.loss) > 0)
        slip = jnp.where(pull > 0, neg(self.loss), self.loss)
        force = jnp.where(sticks, mul(self.weight, self.reference), slip)
        return jnp.where(sticks, self.weight, 0), force

    def effect(self, model: ZoneModel) -> tuple[Scalar, Scalar]:
        """See `DofConstraint.effect`."""
        return model[0], model[1]


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
                    found.append(Friction(dof, loss, mul(weight, jnp.ones_like(v[dof])), reference))
            if joint.limited and joint.kind == BALL:
                _, angle = axis_angle(unit_quaternion(here))
                distance = sub(parameters.one(f"{key}/range"), angle)
                found.append(_limit(parameters, key, joint.dofs[0], -1.0, distance, v[joint.dofs[0]]))
            elif joint.limited:
                dof, (lower, upper) = joint.dofs[0], parameters[f"{key}/range"]
                for sign, distance in ((1.0, sub(here[0], lower)), (-1.0, sub(upper, here[0]))):
                    found.append(_limit(parameters, key, dof, sign, distance, v[dof]))
    return found


def _limit(parameters: Parameters, key: str, dof: int, sign: float, distance: Scalar, v: jax.Array) -> Limit:
    beyond = sub(distance, parameters.one(f"{key}/limit_margin"))
    strength, reference = constraint_law(parameters, f"{key}/limit_", beyond, mul(sign, v))
    return Limit(dof, sign, jnp.where(beyond < 0, strength, 0), reference)
