"""Constraints of one row over a few joints: equality of joints or tendons, limits and dry friction of fixed tendons.

All rows of a kind stand side by side as the slots of a `Coupling`, arrays (K, C).

Source: google-deepmind/mujoco, mj_instantiateEquality, mj_instantiateFriction, mj_instantiateLimit.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from btr_mjx.engines.guards.placed_geoms import member, stack_rows
from btr_mjx.engines.lanes_engine.constraints.body_contacts import Column, Coupling
from btr_mjx.engines.lanes_engine.constraints.cones import Bilateral, Cone, DryFriction, Frictionless, constraint_law
from btr_mjx.engines.lanes_engine.kinematics import path_motion
from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.tree import Path, TreePlan
from btr_mjx.engines.scalars import Scalar, add, array, is_zero, mul, neg, sub

type _Jacobian = list[dict[int, Scalar]]
"""Per row, the derivative of its length by the coordinates of MuJoCo's joints."""


class _Rows:
    """The state from which rows are made."""

    def __init__(
        self,
        plan: TreePlan,
        columns: Sequence[Column],
        parameters: Parameters,
        q: Sequence[Sequence[jax.Array]],
        v: Sequence[jax.Array],
        dtype: Any,
    ):
        self.plan, self.parameters, self.q, self.v = plan, parameters, q, v
        self.lanes, self.dtype = v[0].shape[-1], dtype
        ids = {(joint.dofs[0], n): j for joint in plan.joints for n, j in enumerate(joint.ids)}
        self.columns = [(ids.get((column.dof, column.member), -1), column) for column in columns]

    def motion(self, paths: Sequence[Path]) -> list[jax.Array]:
        """Lengths and velocities of paths, (K, C)."""
        found = [path_motion(self.plan, path, self.q, self.v) for path in paths]
        return [stack_rows(rows, self.lanes, self.dtype) for rows in zip(*found, strict=True)]

    def coupling(
        self, jacobian: _Jacobian, kind: type[Cone], weight: Scalar, reference: Scalar, *more: Scalar
    ) -> Coupling:
        """Rows of one kind."""
        chosen, entries = [], []
        for joint, column in self.columns:
            own = [row.get(joint, 0.0) for row in jacobian]
            if not all(map(is_zero, own)):
                chosen.append(column)
                constant = all(isinstance(x, float) for x in own)
                entries.append(np.array(own)[:, None] if constant else stack_rows(own, self.lanes, self.dtype))
        weight = array(weight, (len(jacobian), self.lanes), self.dtype)
        return Coupling(chosen, [entries], kind([], [], weight, [reference, 0.0, 0.0], *more))

    def equalities(self) -> Coupling:
        """Length of the first side = polynomial in that of the second."""
        sides = [(e.sides[0], e.sides[1] if len(e.sides) > 1 else ()) for e in self.plan.equalities]
        (one, rate), (other, other_rate) = (self.motion(paths) for paths in zip(*sides, strict=True))
        zero, polynomial = self.parameters["equality/zero"], self.parameters["equality/polynomial"]
        x, value, slope = sub(other, zero[1]), polynomial[4], mul(4.0, polynomial[4])
        for power in (3, 2, 1, 0):
            value = add(polynomial[power], mul(x, value))
            slope = add(mul(float(power), polynomial[power]), mul(x, slope)) if power else slope
        weight, reference = constraint_law(
            self.parameters, "equality/", sub(sub(one, zero[0]), value), sub(rate, mul(slope, other_rate))
        )
        jacobian: _Jacobian = []
        for k, (first, second) in enumerate(sides):
            row: dict[int, Scalar] = dict(first)
            for joint, factor in second:
                row[joint] = sub(row.get(joint, 0.0), mul(factor, member(slope, k)))
            jacobian.append(row)
        return self.coupling(jacobian, Bilateral, weight, reference)

    def limits(self) -> Coupling:
        """Both sides of the range of every tendon that has one."""
        paths = [tendon.path for tendon in self.plan.tendons if tendon.limited for _ in range(2)]
        signs = [1.0, -1.0] * (len(paths) // 2)
        length, rate = self.motion(paths)
        sign = np.array(signs)[:, None]
        bound, margin = (self.parameters.one(f"tendon_limit/{key}") for key in ("bound", "margin"))
        beyond = sub(mul(sign, sub(length, bound)), margin)
        weight, reference = constraint_law(self.parameters, "tendon_limit/", beyond, mul(sign, rate))
        jacobian = [{j: s * factor for j, factor in path} for s, path in zip(signs, paths, strict=True)]
        return self.coupling(jacobian, Frictionless, jnp.where(beyond < 0, weight, 0), reference)

    def frictions(self) -> Coupling:
        """Friction loss of tendons."""
        paths = [tendon.path for tendon in self.plan.tendons if tendon.friction]
        keys = ("loss", "loss_weight", "loss_damping")
        loss, weight, damping = (self.parameters.one(f"tendon_friction/{key}") for key in keys)
        reference = mul(neg(damping), self.motion(paths)[1])
        return self.coupling([dict(path) for path in paths], DryFriction, weight, reference, loss)


def path_rows(
    plan: TreePlan,
    columns: Sequence[Column],
    parameters: Parameters,
    q: Sequence[Sequence[jax.Array]],
    v: Sequence[jax.Array],
    dtype: Any,
) -> list[Coupling]:
    """All such rows of a chunk; limits that are not violated have weight zero."""
    rows = _Rows(plan, columns, parameters, q, v, dtype)
    found = [rows.equalities()] if plan.equalities else []
    found += [rows.limits()] if any(tendon.limited for tendon in plan.tendons) else []
    return found + ([rows.frictions()] if any(tendon.friction for tendon in plan.tendons) else [])
