"""Equality of bodies: connect joins two points, weld two frames.

All constraints of a kind stand side by side as the slots of a `Coupling` with three rows for the points, and of another
with three rows for the turns of welds, arrays (K, C).

Source: google-deepmind/mujoco, mj_instantiateEquality, mj_Jdotv.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from btr_mjx.engines.guards.placed_geoms import member, stack_rows
from btr_mjx.engines.lanes_engine.constraints.body_contacts import Column, Coupling
from btr_mjx.engines.lanes_engine.constraints.cones import Bilateral, impedance
from btr_mjx.engines.lanes_engine.kinematics import Motion, matrix_quaternion, world_motion
from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.tree import Closure, TreePlan
from btr_mjx.engines.scalars import (
    UNIT,
    Matrix,
    Scalar,
    Vector,
    array,
    constant,
    cross,
    dot,
    is_zero,
    matmul,
    matvec,
    mul,
    scale,
    sub,
    total,
    transpose,
    vadd,
    vsub,
)


@dataclass(frozen=True)
class _Frames:
    """The frames on one side of K constraints, scalars (K, C)."""

    point: Vector
    """Origins in the world [m]."""
    axes: Matrix
    """Rotations from frames to the world."""
    spin: Vector
    """Angular velocities [rad/s]."""
    drift: Vector
    """Accelerations of the origins at zero joint accelerations, minus gravity [m/s^2]."""
    turn_drift: Vector
    """Angular accelerations at zero joint accelerations [rad/s^2]."""


@dataclass(frozen=True)
class _Rows:
    """Three rows of K constraints, scalars (K, C)."""

    rates: Sequence[Vector]
    """Per column, the rate of the residual per unit of the dof's velocity."""
    residual: Vector
    drift: Vector
    """Second derivative of the residual at zero joint accelerations."""
    scale: str
    """Name of the parameter with the weight's factor."""


def closures(
    plan: TreePlan,
    columns: Sequence[Column],
    parameters: Parameters,
    motions: Sequence[Motion],
    v: Sequence[jax.Array],
    dtype: Any,
) -> list[Coupling]:
    """All such constraints of a chunk; velocities are per dof, of free joints in world axes."""
    found: list[Coupling] = []
    for kind in ("connect", "weld"):
        own = [closure for closure in plan.closures if closure.kind == kind]
        if own:
            found += _Kind(kind, own, plan, columns, parameters, motions, v, dtype).couplings()
    return found


@dataclass(frozen=True)
class _Kind:
    """The constraints of one kind."""

    kind: str
    own: Sequence[Closure]
    plan: TreePlan
    columns: Sequence[Column]
    parameters: Parameters
    motions: Sequence[Motion]
    v: Sequence[jax.Array]
    dtype: Any

    def couplings(self) -> list[Coupling]:
        """Rows of the points, and of the turns of welds."""
        one, other = self._frames(0), self._frames(1)
        shifts, turns = self._moves(one, other)
        rows = [_Rows(shifts, vsub(one.point, other.point), vsub(one.drift, other.drift), "scale")]
        if self.kind == "weld":
            rows.append(_turning(one, other, turns, self.parameters.one("weld/torquescale")))
        square = total(dot(own.residual, own.residual) for own in rows)
        # Where the residual is zero, the derivative of its root is not finite.
        size = jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)
        imp = impedance(self.parameters[f"{self.kind}/impedance"], size)
        return [coupling for own in rows for coupling in self._coupled(own, imp)]

    def _frames(self, side: int) -> _Frames:
        """The frames of the first (0) or the second bodies (1)."""
        places = [self.plan.place(closure.roots[side]) or (-1, 0) for closure in self.own]
        links = [*self.motions, world_motion(self.parameters)]

        def stacked(vectors: Sequence[Vector]) -> list[Scalar]:
            """A vector of each constraint's link, from those of all links."""
            found = []
            for numbers in zip(*(vectors[link] for link, _ in places), strict=True):
                rows = [member(x, n) for x, (_, n) in zip(numbers, places, strict=True)]
                known = all(isinstance(x, float) for x in rows)
                found.append(constant(rows) if known else stack_rows(rows, self.v[0].shape[-1], self.dtype))
            return found

        rotation = [stacked([m.rotation[i] for m in links]) for i in range(3)]
        spin = stacked([m.angular_velocity for m in links])
        turn_drift = stacked([m.angular_acceleration for m in links])
        arm = matvec(rotation, self.parameters[f"{self.kind}/point{side}"])
        sweep = vadd(cross(turn_drift, arm), cross(spin, cross(spin, arm)))
        return _Frames(
            vadd(stacked([m.position for m in links]), arm),
            matmul(rotation, self.parameters.matrix(f"{self.kind}/axes{side}")),
            spin,
            vadd(stacked([m.acceleration for m in links]), sweep),
            turn_drift,
        )

    def _moves(self, one: _Frames, other: _Frames) -> tuple[list[Vector], list[Vector]]:
        """Velocity and angular velocity of the first frame relative to the second, per unit of each column's."""
        shifts: list[Vector] = []
        turns: list[Vector] = []
        for column in self.columns:
            m = self.motions[column.link]
            linear, angular, origin = (
                [member(x, column.member) for x in part] for part in (*m.columns[column.axis], m.position)
            )
            first, second = (
                constant([float(column.first <= closure.bodies[side] <= column.last) for closure in self.own])
                for side in (0, 1)
            )
            lever = vsub(scale(first, vsub(one.point, origin)), scale(second, vsub(other.point, origin)))
            sign = sub(first, second)
            shifts.append(vadd(scale(sign, linear), cross(angular, lever)))
            turns.append(scale(sign, angular))
        return shifts, turns

    def _coupled(self, own: _Rows, imp: jax.Array) -> list[Coupling]:
        """The constraints at an impedance (mj_makeImpedance); none where nothing moves them."""
        moved = [pair for pair in zip(self.columns, own.rates, strict=True) if not all(map(is_zero, pair[1]))]
        if not moved:
            return []
        chosen, jacobian = [column for column, _ in moved], transpose([rate for _, rate in moved])
        speed = [dot(row, [member(self.v[c.dof], c.member) for c in chosen]) for row in jacobian]
        stiffness, damping = self.parameters[f"{self.kind}/reference"]
        pull = vadd(scale(damping, speed), scale(mul(stiffness, imp), own.residual))
        weight = mul(self.parameters.one(f"{self.kind}/{own.scale}"), imp / (1.0 - imp))
        weight = array(weight, (len(self.own), self.v[0].shape[-1]), self.dtype)
        return [Coupling(chosen, jacobian, Bilateral([], [], weight, scale(-1.0, vadd(pull, own.drift))))]


def _turning(one: _Frames, other: _Frames, turns: Sequence[Vector], torquescale: Scalar) -> _Rows:
    """The turns of welds: the residual is the vector part of the quaternion that takes the second frame to the first.

    With the quaternion (w, e) and the angular velocity u between the frames, all in the second frame, its rate is
    (w u + u x e) / 2, of w it is -(u . e) / 2.
    """
    back, half = transpose(other.axes), mul(0.5, torquescale)
    w, *e = matrix_quaternion(matmul(back, one.axes))
    turned = [matvec(back, axis) for axis in UNIT]
    rate = transpose([scale(half, vadd(scale(w, u), cross(u, e))) for u in turned])
    spin, drift = vsub(one.spin, other.spin), vsub(one.turn_drift, other.turn_drift)
    drift = matvec(rate, vsub(drift, cross(other.spin, spin)))  # the axes of the second frame turn, too
    drift = vsub(drift, scale(mul(mul(0.5, half), dot(spin, spin)), e))
    return _Rows([matvec(rate, turn) for turn in turns], scale(torquescale, e), drift, "turn_scale")
