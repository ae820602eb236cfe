"""Effects that are similar to effects of the library: other functions of the state at the same place.

A hardening spring is similar to a stiffness, an elastic cord to a constant force. They are searched only if selected
by name.
"""

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Effect, Parameter
from btr_mjx.gap.effects.places import Place, body_place, joint_places
from btr_mjx.gap.effects.ranges import Scales, typical_scale, unit_of
from btr_mjx.gap.simulate import Rows, StateLaw, World


def _cubic(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = typical_scale(scales.torque, place, model) / typical_scale(scales.amplitude, place, model) ** 3
    unit = unit_of(model, place, "N m/rad^3", "N/m^3")
    return (Parameter("cubic", unit, -3.0 * size, 9.0 * size, 0.06 * size),)


def _apply_cubic(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = -k3 (q - q_spring)^3, the cubic term of MuJoCo's joint springs."""
    world.model.jnt_stiffnesspoly[list(place.joints), 1] += values[0]


def _pull_to_one_side(rows: Rows, dofs: np.ndarray, positions: np.ndarray, stiffness: float) -> None:
    """Joint forces -k |q - q_spring|."""
    away = rows.qpos[:, positions] - rows.model.qpos_spring[positions]
    rows.qfrc_applied[:, dofs] -= stiffness * np.abs(away)


def _one_sided(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = typical_scale(scales.torque, place, model) / typical_scale(scales.amplitude, place, model)
    return (Parameter("stiffness", unit_of(model, place, "N m/rad", "N/m"), -3.0 * size, 3.0 * size, 0.02 * size),)


def _apply_one_sided(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = -k |q - q_spring|; together with a stiffness k, a cable that is slack on one side."""
    model = world.model
    positions = model.jnt_qposadr[list(place.joints)].astype(int)
    world.laws.append(StateLaw(_pull_to_one_side, (place.dofs(model), positions, float(values[0]))))


def _pull_to_anchor(rows: Rows, body: int, position: int, stiffness: float) -> None:
    """Force -k (x - x0) on a free body with its position at this address in qpos, x0 that in qpos0."""
    here = slice(position, position + 3)
    rows.xfrc_applied[:, body, :3] -= stiffness * (rows.qpos[:, here] - rows.model.qpos0[here])


def _free_joint(model: mujoco.MjModel, body: int) -> int | None:
    first = int(model.body_jntadr[body])
    return first if first >= 0 and int(model.jnt_type[first]) == int(mujoco.mjtJoint.mjJNT_FREE) else None


def _cord(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = 9.81 * float(model.body_subtreemass[place.bodies[0]]) / scales.length
    return (Parameter("stiffness", "N/m", -3.0 * size, 3.0 * size, 0.02 * size),)


def _apply_cord(world: World, place: Place, values: np.ndarray) -> None:
    """F = -k (x - x0), x0 the position in qpos0; together with a constant force, an elastic cord to any fixed point."""
    (body,) = place.bodies
    joint = _free_joint(world.model, body)
    assert joint is not None
    world.laws.append(StateLaw(_pull_to_anchor, (body, int(world.model.jnt_qposadr[joint]), float(values[0]))))


HARDENING_SPRING = Effect(
    "hardening_spring",
    joint_places,
    _cubic,
    _apply_cubic,
    excited_by="deflections of several sizes",
    summable=True,
    equation="τ = −k₃ (q − q_spring)³",
)
ONE_SIDED_SPRING = Effect(
    "one_sided_spring",
    joint_places,
    _one_sided,
    _apply_one_sided,
    excited_by="deflections to both sides",
    summable=True,
    equation="τ = −k |q − q_spring|",
)
ELASTIC_CORD = Effect(
    "elastic_cord",
    lambda model: [body_place(model, b) for b in range(1, model.nbody) if _free_joint(model, b) is not None],
    _cord,
    _apply_cord,
    excited_by="travel of the body",
    equation="a force −k (x − x₀) on the body",
)

SIMILAR_EFFECTS = (HARDENING_SPRING, ONE_SIDED_SPRING, ELASTIC_CORD)
