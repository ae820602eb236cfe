"""Effects at joints: damping, friction, inertia, springs, encoder offsets, backlash."""

from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.effect import Effect, Parameter
from btr_mjx.gap.laws import Rows
from btr_mjx.gap.places import Place, actuator_count, joint_of, joint_places
from btr_mjx.gap.scales import Scales
from btr_mjx.gap.worlds import World

AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)


def _least(model: mujoco.MjModel, field: str, place: Place) -> float:
    """The smallest believed value of a field among the place's joints: it cannot go below zero."""
    return float(np.min(getattr(model, field)[place.dofs(model)]))


def _typical(values: np.ndarray, place: Place, model: mujoco.MjModel) -> float:
    """One size for a place: the geometric mean over its joints."""
    return float(np.exp(np.mean(np.log(np.maximum(values[place.dofs(model)], 1e-300)))))


def _unit(model: mujoco.MjModel, place: Place, hinge: str, slide: str) -> str:
    kinds = model.jnt_type[list(place.joints)]
    return hinge if (kinds == int(mujoco.mjtJoint.mjJNT_HINGE)).all() else slide


def _damping(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = _typical(scales.torque, place, model) / _typical(scales.speed, place, model)
    unit = _unit(model, place, "N m s/rad", "N s/m")
    believed = _least(model, "dof_damping", place)
    return (Parameter("damping", unit, -believed, 3.0 * size, 0.05 * size, 0.01 * believed),)


def _apply_damping(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = -d qvel; d is added to the believed damping."""
    world.model.dof_damping[place.dofs(world.model)] += values[0]


def _friction(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = _typical(scales.torque, place, model)
    unit = _unit(model, place, "N m", "N")
    return (Parameter("torque", unit, -_least(model, "dof_frictionloss", place), 0.8 * size, 0.02 * size),)


def _apply_friction(world: World, place: Place, values: np.ndarray) -> None:
    """|tau| <= f, against the motion (Coulomb); f is added to the believed frictionloss."""
    world.model.dof_frictionloss[place.dofs(world.model)] += values[0]


@dataclass(frozen=True)
class LoadFriction:
    """Friction loss f = mu |tau|, tau the actuators' generalised force in the last step.

    Attributes:
      dofs: degrees of freedom.
      coefficient: mu [1].
    """

    dofs: np.ndarray
    coefficient: float
    fields: tuple[str, ...] = ("dof_frictionloss",)

    def __call__(self, rows: Rows) -> None:
        """Add to the friction loss of the coming step."""
        rows.field("dof_frictionloss")[:, self.dofs] += self.coefficient * np.abs(rows.qfrc_actuator[:, self.dofs])


def _load(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("coefficient", "1", 0.0, 0.9, 0.02),)


def _apply_load(world: World, place: Place, values: np.ndarray) -> None:
    """|tau_f| <= f0 + mu |tau_motor|: the more a gear carries, the more it rubs."""
    world.laws.append(LoadFriction(place.dofs(world.model), float(values[0])))


@dataclass(frozen=True)
class StribeckFriction:
    """Friction loss f = F exp(-(qvel / v)^2): what a joint needs to break away.

    Attributes:
      dofs: degrees of freedom.
      torque: F [N m or N].
      speed: v [rad/s or m/s].
    """

    dofs: np.ndarray
    torque: float
    speed: float
    fields: tuple[str, ...] = ("dof_frictionloss",)

    def __call__(self, rows: Rows) -> None:
        """Add to the friction loss of the coming step."""
        fall = np.exp(-((rows.qvel[:, self.dofs] / self.speed) ** 2))
        rows.field("dof_frictionloss")[:, self.dofs] += self.torque * fall


def _stribeck(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    torque, speed = _typical(scales.torque, place, model), _typical(scales.speed, place, model)
    return (
        Parameter("torque", _unit(model, place, "N m", "N"), 0.0, 0.8 * torque, 0.02 * torque),
        Parameter(
            "speed",
            _unit(model, place, "rad/s", "m/s"),
            0.01 * speed,
            0.5 * speed,
            0.02 * speed,
            null=0.1 * speed,
            shape=True,
        ),
    )


def _apply_stribeck(world: World, place: Place, values: np.ndarray) -> None:
    """|tau| <= f0 + F exp(-(qvel / v)^2): a joint that must break away before it glides."""
    world.laws.append(StribeckFriction(place.dofs(world.model), float(values[0]), float(values[1])))


def _armature(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size, believed = _typical(scales.inertia, place, model), _least(model, "dof_armature", place)
    unit = _unit(model, place, "kg m^2", "kg")
    return (Parameter("armature", unit, -believed, 5.0 * size, 0.05 * size, 0.01 * believed),)


def _apply_armature(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = -I qacc: inertia of rotor and gear, added to the believed armature."""
    world.model.dof_armature[place.dofs(world.model)] += values[0]


def _stiffness(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = _typical(scales.torque, place, model) / _typical(scales.amplitude, place, model)
    return (Parameter("stiffness", _unit(model, place, "N m/rad", "N/m"), -1.0 * size, 3.0 * size, 0.02 * size),)


def _apply_stiffness(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = -k (q - q_spring): cables, seals; k is added to the believed stiffness, negative values push outwards."""
    model, joints = world.model, list(place.joints)
    model.jnt_stiffness[joints] += values[0]


def _offset(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    hinge = _unit(model, place, "rad", "m") == "rad"
    reach = 0.3 if hinge else 0.3 * scales.length
    return (Parameter("offset", "rad" if hinge else "m", -reach, reach, reach / 60, reach / 600),)


def _apply_offset(world: World, place: Place, values: np.ndarray) -> None:
    """q_measured = q_true + offset: the encoder's zero is wrong, and the servo tracks what the encoder says.

    Seen from the encoder the robot is assembled differently: the joint's reference position moves, and with it the
    spring's and the limits', which belong to the true angle.
    """
    model = world.model
    for j in place.joints:
        address = model.jnt_qposadr[j]
        model.qpos0[address] += values[0]
        model.qpos_spring[address] += values[0]
        if model.jnt_limited[j]:
            model.jnt_range[j] += values[0]


@dataclass(frozen=True)
class Backlash:
    """A dead zone in the error of position servos: e -> e - clip(e, -b, b), e = r - gear q.

    Attributes:
      controls: indices of the servos' position references.
      positions: addresses of the joints in qpos.
      gear: (n,) gears.
      play: b [rad or m at the joint].
    """

    controls: np.ndarray
    positions: np.ndarray
    gear: np.ndarray
    play: float
    fields: tuple[str, ...] = ()

    def __call__(self, rows: Rows) -> None:
        """Shift the reference of the coming step."""
        reach = np.abs(self.gear) * self.play
        error = rows.ctrl[:, self.controls] - self.gear * rows.qpos[:, self.positions]
        rows.ctrl[:, self.controls] -= np.clip(error, -reach, reach)


def position_servos(model: mujoco.MjModel) -> list[int]:
    """Actuators that pull a hinge or slide towards a reference position."""
    return [
        a
        for a in range(actuator_count(model))
        if joint_of(model, a) is not None
        and int(model.actuator_biastype[a]) == AFFINE
        and model.actuator_biasprm[a, 1] < 0
    ]


def _servo_joints(model: mujoco.MjModel) -> list[Place]:
    servos = set(position_servos(model))
    places = joint_places(model, [j for a in servos if (j := joint_of(model, a)) is not None])
    return [place for place in places if servos.intersection(place.actuators)]


def _backlash(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = _typical(scales.amplitude, place, model)
    return (Parameter("play", _unit(model, place, "rad", "m"), 0.0, 0.7 * size, 0.02 * size),)


def _apply_backlash(world: World, place: Place, values: np.ndarray) -> None:
    """The servo only feels the part of its error beyond a dead zone of half width b (the gear's play)."""
    model = world.model
    servos = [a for a in place.actuators if a in set(position_servos(model))]
    joints = model.actuator_trnid[servos, 0]
    world.laws.append(
        Backlash(
            model.actuator_ctrladr[servos].astype(int),
            model.jnt_qposadr[joints].astype(int),
            model.actuator_gear[servos, 0].copy(),
            float(values[0]),
        )
    )


def _driven(model: mujoco.MjModel) -> list[Place]:
    """Joints with an actuator."""
    joints = {joint_of(model, a) for a in range(actuator_count(model))} - {None}
    return joint_places(model, [j for j in joints if j is not None])


VISCOUS_DAMPING = Effect(
    "viscous_damping",
    joint_places,
    _damping,
    _apply_damping,
    excited_by="fast motion of the joint, at several speeds",
    summable=True,
    equation="τ = −d q̇",
)
DRY_FRICTION = Effect(
    "dry_friction",
    joint_places,
    _friction,
    _apply_friction,
    excited_by="reversals of the joint's motion",
    summable=True,
    equation="|τ| ≤ f, against the motion",
)
LOAD_FRICTION = Effect(
    "load_friction",
    _driven,
    _load,
    _apply_load,
    excited_by="motion under loads of several sizes",
    summable=True,
    equation="|τ| ≤ μ |τ_motor|, against the motion",
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
ARMATURE = Effect(
    "armature",
    joint_places,
    _armature,
    _apply_armature,
    excited_by="strong accelerations of the joint",
    summable=True,
    equation="τ = −I q̈",
)
JOINT_STIFFNESS = Effect(
    "joint_stiffness",
    joint_places,
    _stiffness,
    _apply_stiffness,
    excited_by="large deflections of the joint, slow ones too",
    summable=True,
    equation="τ = −k (q − q_spring)",
)
JOINT_OFFSET = Effect(
    "joint_offset",
    lambda model: [place for place in joint_places(model) if not place.members],
    _offset,
    _apply_offset,
    excited_by="loads that depend on the true angle: weight, contact",
    equation="q_measured = q_true + offset",
)
BACKLASH = Effect(
    "backlash",
    _servo_joints,
    _backlash,
    _apply_backlash,
    excited_by="reversals of the load and small motions",
    summable=True,
    equation="servo error e → e − clip(e, −b, b)",
)

JOINT_EFFECTS = (
    VISCOUS_DAMPING,
    DRY_FRICTION,
    LOAD_FRICTION,
    STRIBECK_FRICTION,
    ARMATURE,
    JOINT_STIFFNESS,
    JOINT_OFFSET,
    BACKLASH,
)
