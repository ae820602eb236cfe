"""Effects at joints besides friction: armature, stiffness, encoder offset, backlash."""

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Effect, Parameter
from btr_mjx.gap.effects.per_member import per_member
from btr_mjx.gap.effects.places import Place, actuator_count, joint_of, joint_places
from btr_mjx.gap.effects.ranges import Scales, smallest_believed, typical_scale, unit_of
from btr_mjx.gap.simulate import Rows, StateLaw, World

AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)


def _armature(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size, believed = typical_scale(scales.inertia, place, model), smallest_believed(model, "dof_armature", place)
    unit = unit_of(model, place, "kg m^2", "kg")
    # The reflected inertia of a rotor may exceed that of a light link; the bound is what the motors can accelerate.
    torque, amplitude, speed = (typical_scale(x, place, model) for x in (scales.torque, scales.amplitude, scales.speed))
    most = max(5.0 * size, 3.0 * torque * amplitude / speed**2)
    return (Parameter("armature", unit, -believed, most, 0.05 * size, 0.01 * believed, floor=True),)


def _apply_armature(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = -I qacc: reflected inertia of rotor and gear, added to the believed armature."""
    world.model.dof_armature[place.dofs(world.model)] += values[0]


def _stiffness(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = typical_scale(scales.torque, place, model) / typical_scale(scales.amplitude, place, model)
    unit = unit_of(model, place, "N m/rad", "N/m")
    return (Parameter("stiffness", unit, -1.0 * size, 3.0 * size, 0.02 * size),)


def _apply_stiffness(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = -k (q - q_spring), such as of cables or seals; k is added to the believed stiffness and may be negative."""
    world.model.jnt_stiffness[list(place.joints)] += values[0]


def _offset(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    hinge = unit_of(model, place, "rad", "m") == "rad"
    reach = 0.3 if hinge else 0.3 * scales.length
    return (Parameter("offset", "rad" if hinge else "m", -reach, reach, reach / 60, reach / 600),)


def _apply_offset(world: World, place: Place, values: np.ndarray) -> None:
    """q_measured = q_true + offset: error of the encoder zero; the servo tracks the measured angle.

    In measured coordinates the reference position, the spring reference and the limits of the joint, which refer to
    the true angle, shift by the offset.
    """
    model = world.model
    for j in place.joints:
        address = model.jnt_qposadr[j]
        model.qpos0[address] += values[0]
        model.qpos_spring[address] += values[0]
        if model.jnt_limited[j]:
            model.jnt_range[j] += values[0]


def _add_backlash(rows: Rows, controls: np.ndarray, positions: np.ndarray, gear: np.ndarray, play: float) -> None:
    """A dead zone in the error of position servos: e -> e - clip(e, -b, b), e = r - gear q, b the play at the joint."""
    reach = np.abs(gear) * play
    rows.ctrl[:, controls] -= np.clip(rows.ctrl[:, controls] - gear * rows.qpos[:, positions], -reach, reach)


def position_servos(model: mujoco.MjModel) -> list[int]:
    """Ids of the position servos: affine actuators of hinges or slides with negative position feedback."""
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
    size = typical_scale(scales.amplitude, place, model)
    return (Parameter("play", unit_of(model, place, "rad", "m"), 0.0, 0.7 * size, 0.02 * size),)


def _apply_backlash(world: World, place: Place, values: np.ndarray) -> None:
    """Dead zone of half width b (gear play) in the position error of the servo."""
    model = world.model
    servos = [a for a in place.actuators if a in set(position_servos(model))]
    positions = model.jnt_qposadr[model.actuator_trnid[servos, 0]].astype(int)
    controls, gear = model.actuator_ctrladr[servos].astype(int), model.actuator_gear[servos, 0].copy()
    world.laws.append(StateLaw(_add_backlash, (controls, positions, gear, float(values[0]))))


ARMATURE = per_member(
    Effect(
        "armature",
        joint_places,
        _armature,
        _apply_armature,
        excited_by="strong accelerations of the joint",
        summable=True,
        equation="τ = −I q̈",
    )
)
JOINT_STIFFNESS = per_member(
    Effect(
        "joint_stiffness",
        joint_places,
        _stiffness,
        _apply_stiffness,
        excited_by="large deflections of the joint, slow ones too",
        summable=True,
        equation="τ = −k (q − q_spring)",
    )
)
JOINT_OFFSET = Effect(
    "joint_offset",
    lambda model: [place for place in joint_places(model) if not place.members],
    _offset,
    _apply_offset,
    excited_by="loads that depend on the true angle: weight, contact",
    equation="q_measured = q_true + offset",
)
BACKLASH = per_member(
    Effect(
        "backlash",
        _servo_joints,
        _backlash,
        _apply_backlash,
        excited_by="reversals of the load and small motions",
        summable=True,
        equation="servo error e → e − clip(e, −b, b)",
    )
)

JOINT_EFFECTS = (ARMATURE, JOINT_STIFFNESS, JOINT_OFFSET, BACKLASH)
