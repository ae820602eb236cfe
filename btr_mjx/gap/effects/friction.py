"""Joint friction: viscous, Coulomb, load-dependent, Stribeck."""

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Effect, Parameter
from btr_mjx.gap.effects.per_member import per_member
from btr_mjx.gap.effects.places import Place, actuator_count, joint_of, joint_places
from btr_mjx.gap.effects.ranges import Scales, smallest_believed, typical_scale, unit_of
from btr_mjx.gap.simulate import Rows, StateLaw, World


def _damping(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = typical_scale(scales.torque, place, model) / typical_scale(scales.speed, place, model)
    unit = unit_of(model, place, "N m s/rad", "N s/m")
    believed = smallest_believed(model, "dof_damping", place)
    # Small errors of damping are not named. They are no tolerance, which could absorb part of a strong friction.
    negligible = min(0.4 * believed, max(0.04 * believed, 4e-3 * size))
    tolerance = 0.01 * believed
    return (
        Parameter("damping", unit, -believed, 3.0 * size, 0.05 * size, tolerance, negligible=negligible, floor=True),
    )


def _apply_damping(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = -d qvel, d added to the believed damping."""
    world.model.dof_damping[place.dofs(world.model)] += values[0]


def _friction(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = typical_scale(scales.torque, place, model)
    unit = unit_of(model, place, "N m", "N")
    believed = smallest_believed(model, "dof_frictionloss", place)
    return (Parameter("torque", unit, -believed, 0.8 * size, 0.02 * size, floor=True),)


def _apply_friction(world: World, place: Place, values: np.ndarray) -> None:
    """|tau| <= f, against the motion (Coulomb), f added to the believed frictionloss."""
    world.model.dof_frictionloss[place.dofs(world.model)] += values[0]


def _add_load_friction(rows: Rows, dofs: np.ndarray, coefficient: float) -> None:
    """Friction loss mu |tau|, tau the generalised force of the actuators in the last step."""
    rows.field("dof_frictionloss")[:, dofs] += coefficient * np.abs(rows.qfrc_actuator[:, dofs])


def _apply_load(world: World, place: Place, values: np.ndarray) -> None:
    """|tau_f| <= f0 + mu |tau_motor|: gear friction proportional to the load."""
    numbers = place.dofs(world.model), float(values[0])
    world.laws.append(StateLaw(_add_load_friction, numbers, ("dof_frictionloss",)))


def _add_stribeck_friction(rows: Rows, dofs: np.ndarray, torque: float, speed: float) -> None:
    """Friction loss F exp(-(qvel / v)^2)."""
    rows.field("dof_frictionloss")[:, dofs] += torque * np.exp(-((rows.qvel[:, dofs] / speed) ** 2))


def _stribeck(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    torque, speed = typical_scale(scales.torque, place, model), typical_scale(scales.speed, place, model)
    return (
        Parameter("torque", unit_of(model, place, "N m", "N"), 0.0, 0.8 * torque, 0.02 * torque),
        Parameter(
            "speed",
            unit_of(model, place, "rad/s", "m/s"),
            0.01 * speed,
            0.5 * speed,
            0.02 * speed,
            null=0.1 * speed,
            shape=True,
        ),
    )


def _apply_stribeck(world: World, place: Place, values: np.ndarray) -> None:
    """|tau| <= f0 + F exp(-(qvel / v)^2): breakaway friction (Stribeck)."""
    numbers = place.dofs(world.model), float(values[0]), float(values[1])
    world.laws.append(StateLaw(_add_stribeck_friction, numbers, ("dof_frictionloss",)))


def _driven(model: mujoco.MjModel) -> list[Place]:
    """Joints with an actuator."""
    joints = {joint_of(model, a) for a in range(actuator_count(model))} - {None}
    return joint_places(model, [j for j in joints if j is not None])


VISCOUS_DAMPING = per_member(
    Effect(
        "viscous_damping",
        joint_places,
        _damping,
        _apply_damping,
        excited_by="fast motion of the joint, at several speeds",
        summable=True,
        equation="τ = −d q̇",
    )
)
DRY_FRICTION = per_member(
    Effect(
        "dry_friction",
        joint_places,
        _friction,
        _apply_friction,
        excited_by="reversals of the joint's motion",
        summable=True,
        equation="|τ| ≤ f, against the motion",
    )
)
LOAD_FRICTION = per_member(
    Effect(
        "load_friction",
        _driven,
        lambda *_: (Parameter("coefficient", "1", 0.0, 0.9, 0.02),),
        _apply_load,
        excited_by="motion under loads of several sizes",
        summable=True,
        equation="|τ| ≤ μ |τ_motor|, against the motion",
    )
)
STRIBECK_FRICTION = Effect(
    "stribeck_friction",
    joint_places,
    _stribeck,
    _apply_stribeck,
    excited_by="slow motion and standstill next to fast motion",
    summable=True,
    equation="|τ| ≤ F exp(−(q̇/v)²), against the motion",
)

FRICTION_EFFECTS = (VISCOUS_DAMPING, DRY_FRICTION, LOAD_FRICTION, STRIBECK_FRICTION)
