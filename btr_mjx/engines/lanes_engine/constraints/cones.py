"""Force laws of constraints: rows with zones in which the force is linear (mj_constraintUpdate).

A force depends on the acceleration along the rows of its constraint only, by its shortfall: the reference acceleration
minus the acceleration. Within one zone (separated, sticking, sliding, ...) it is linear in the shortfall, with a
stiffness that is exact for the zone. `friction_cones` has the laws of contacts with friction.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import ClassVar

import jax
import jax.numpy as jnp

from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.scalars import (
    Matrix,
    Scalar,
    Symmetric,
    Vector,
    add,
    dot,
    full,
    matvec,
    mul,
    neg,
    padded,
    scale,
    sub,
    vadd,
)

type ZoneModel = tuple[jax.Array, ...]
"""Coefficients that identify the zone of a constraint and determine its force, see `Cone.force`."""


def impedance(parameters: Sequence[Scalar], depth: Scalar) -> Scalar:
    """MuJoCo's impedance d(r) in (0, 1) at a distance beyond the margin [m or rad], of any sign (getimpedance).

    Its parameters are dmin, dmax, width, midpoint and power.
    """
    low, high, width, middle, power = parameters
    x = jnp.minimum(jnp.abs(mul(1.0 / width, depth)), 1.0)
    rest = sub(1.0, x)
    if isinstance(power, float) and power == 1.0:
        y = x
    elif isinstance(power, float) and power == 2.0:
        upper = sub(1.0, mul(1.0 / sub(1.0, middle), mul(rest, rest)))
        y = jnp.where(sub(x, middle) <= 0, mul(1.0 / middle, mul(x, x)), upper)
    else:
        ones = jnp.ones_like(x)
        middle, power = mul(middle, ones), mul(power, ones)
        upper = sub(1.0, (1.0 - middle) * (rest / (1.0 - middle)) ** power)
        y = jnp.where(x <= middle, middle * (x / middle) ** power, upper)
    return add(low, mul(y, sub(high, low)))


def constraint_law(parameters: Parameters, prefix: str, beyond: Scalar, speed: Scalar) -> tuple[Scalar, Scalar]:
    """Weight and reference acceleration of a row at a violation and its rate (mj_makeImpedance)."""
    imp = impedance(parameters[f"{prefix}impedance"], beyond)
    stiffness, damping = parameters[f"{prefix}reference"]
    weight = mul(parameters.one(f"{prefix}scale"), imp / (1.0 - imp))
    return weight, sub(mul(neg(damping), speed), mul(mul(stiffness, imp), beyond))


@dataclass
class Cone(ABC):
    """The force law of contact points, one for each element; inactive in worlds where `weight` is zero.

    Rows are the normal, and as far as the contact has them two tangents, the rotation about the normal, and those about
    the tangents.
    """

    frame: Matrix
    """Rows: normal and two tangents."""
    friction: Vector
    """Coefficients of sliding, of spinning [m] and of rolling [m], as far as the contact has them."""
    weight: Scalar
    """Inverse regularisation D of each row [kg]; of the normal row for an elliptic cone."""
    reference: Vector
    """Reference acceleration along the rows [m/s^2 or rad/s^2]."""

    quadratic: ClassVar[bool] = True
    """Whether the cost is quadratic within a zone."""

    @property
    def rows(self) -> int:
        """Number of rows that are not always zero."""
        return len(self.reference)

    @abstractmethod
    def model(self, short: Vector) -> ZoneModel:
        """Zone of the cone at a shortfall along the rows."""

    @abstractmethod
    def stiffness(self, model: ZoneModel) -> Symmetric:
        """Derivative of the force by the shortfall, in a zone."""

    def force(self, model: ZoneModel, short: Vector) -> Vector:
        """Force along the rows that a zone has at a shortfall."""
        return matvec(full(self.stiffness(model)), padded(short, 3))

    def settled(self, model: ZoneModel, short: Vector) -> jax.Array:
        """Whether the force at a shortfall is that of a zone."""
        return reduce(jnp.logical_and, [x == y for x, y in zip(model, self.model(short), strict=True)])

    def slopes(self, start: Vector, along: Vector) -> Callable[[Scalar], tuple[Scalar, Scalar]]:
        """First and second derivative of the cost by the length of a step of the shortfall."""
        start, along = padded(start, 3), padded(along, 3)

        def at(length: Scalar) -> tuple[Scalar, Scalar]:
            here = vadd(start, scale(length, along))
            model = self.model(here)
            return dot(self.force(model, here), along), dot(matvec(full(self.stiffness(model)), along), along)

        return at


class Frictionless(Cone):
    """A contact with a normal row only."""

    @property
    def rows(self) -> int:
        """See `Cone.rows`."""
        return 1

    def model(self, short: Vector) -> ZoneModel:
        """Weight of the normal row if it is active, else zero."""
        return (jnp.where(short[0] > 0, self.weight, 0),)

    def stiffness(self, model: ZoneModel) -> Symmetric:
        """See `Cone.stiffness`."""
        return [model[0], 0.0, 0.0, 0.0, 0.0, 0.0]

    def force(self, model: ZoneModel, short: Vector) -> Vector:
        """See `Cone.force`."""
        return [mul(model[0], short[0]), 0.0, 0.0]


class Bilateral(Cone):
    """Rows of the same weight that push and pull."""

    def model(self, short: Vector) -> ZoneModel:
        """Weight of the rows, which are always active."""
        return (self.weight,)

    def stiffness(self, model: ZoneModel) -> Symmetric:
        """See `Cone.stiffness`."""
        return [*[model[0]] * 3, 0.0, 0.0, 0.0]


@dataclass
class DryFriction(Cone):
    """One row whose force opposes motion and is bounded by `loss` (mj_instantiateFriction)."""

    loss: Scalar
    quadratic: ClassVar[bool] = False

    @property
    def rows(self) -> int:
        """See `Cone.rows`."""
        return 1

    def model(self, short: Vector) -> ZoneModel:
        """Stiffness and force: a stiff damper within the bound (sticking), a constant force outside (slipping)."""
        pull = mul(self.weight, short[0])
        sticks = (sub(pull, self.loss) < 0) & (add(pull, self.loss) > 0)
        return jnp.where(sticks, self.weight, 0), jnp.where(sticks, 0, jnp.where(pull > 0, self.loss, neg(self.loss)))

    def stiffness(self, model: ZoneModel) -> Symmetric:
        """See `Cone.stiffness`."""
        return [model[0], 0.0, 0.0, 0.0, 0.0, 0.0]

    def force(self, model: ZoneModel, short: Vector) -> Vector:
        """See `Cone.force`."""
        return [add(mul(model[0], short[0]), model[1]), 0.0, 0.0]
