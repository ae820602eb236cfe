"""Effects of actuators: delay, lag and rate limit of the command, gain error, offset, force limit."""

import math
from functools import partial

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Effect, Parameter
from btr_mjx.gap.effects.per_member import per_member
from btr_mjx.gap.effects.places import Place, actuator_count, actuator_places, joint_of, joint_places
from btr_mjx.gap.effects.ranges import Scales, typical_scale, unit_of
from btr_mjx.gap.simulate import Command, World

_MIN_LIMIT = 0.01
"""Smallest force limit, relative to the peak force of the believed model. The peak may be a short transient of a stiff
servo, far above the limit."""

_HOLD_DELAY = 0.25
"""Negligible delay, as a fraction of the model's time step: the mean delay of commands held over simulation steps of
half that length."""

_LINEAR_GAINS = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE), int(mujoco.mjtGain.mjGAIN_PID))
_LINEAR_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))


def _controlled(model: mujoco.MjModel) -> list[Place]:
    return actuator_places(model, [a for a in range(actuator_count(model)) if model.actuator_ctrlnum[a] > 0])


def _per_control(model: mujoco.MjModel, place: Place, value: float) -> np.ndarray:
    """(nu,) vector with a value at the controls of the place and zero elsewhere."""
    out = np.zeros(model.nu)
    out[place.controls(model)] = value
    return out


def _delay(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    # A negative delay is a clock offset, common to all actuators.
    low = -0.15 * scales.time if len(place.actuators) == actuator_count(model) else 0.0
    return (_time("delay", low, model, scales),)


def _time(name: str, low: float, model: mujoco.MjModel, scales: Scales) -> Parameter:
    high, negligible = max(2.0 * scales.time, 0.03), _HOLD_DELAY * model.opt.timestep
    return Parameter(name, "s", low, high, 0.03 * scales.time, negligible=negligible)


def _apply_delay(world: World, place: Place, values: np.ndarray) -> None:
    """u(t) = command(t - delay): bus and controller latency; negative (all actuators only): commands logged late."""
    world.command_edits.append(partial(Command.shifted, delay=_per_control(world.model, place, float(values[0]))))


def _native_delay(spec: mujoco.MjSpec, model: mujoco.MjModel, place: Place, values: np.ndarray) -> bool:
    """Native actuator delay of MuJoCo, with a history buffer of sufficient length."""
    if values[0] < 0:
        return False
    for actuator in (spec.actuators[a] for a in place.actuators):
        actuator.delay = actuator.delay + float(values[0])
        actuator.nsample = max(int(actuator.nsample), math.ceil(actuator.delay / model.opt.timestep) + 2)
        actuator.interp = 1
    return True


def _lag(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    return (_time("time_constant", 0.0, model, scales),)


def _apply_lag(world: World, place: Place, values: np.ndarray) -> None:
    """T du/dt = command - u: first-order lag of the control."""
    constant = _per_control(world.model, place, float(values[0]))
    world.command_edits.append(partial(Command.filtered, time_constant=constant))


def _native_lag(spec: mujoco.MjSpec, model: mujoco.MjModel, place: Place, values: np.ndarray) -> bool:
    """Native dyntype "filterexact", for actuators without activation state."""
    actuators = [spec.actuators[a] for a in place.actuators]
    free = all(a.dyntype == mujoco.mjtDyn.mjDYN_NONE for a in actuators)
    if not free or any(model.actuator_ctrllimited[a] or model.actuator_ctrlnum[a] != 1 for a in place.actuators):
        return False
    for actuator in actuators:
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        actuator.dynprm[0] = float(values[0])
    return True


def linear_actuators(model: mujoco.MjModel) -> list[Place]:
    """Actuators whose force is affine in command and state, and their groups."""
    linear = np.isin(model.actuator_gaintype, _LINEAR_GAINS) & np.isin(model.actuator_biastype, _LINEAR_BIASES)
    return actuator_places(model, np.flatnonzero(linear).tolist())


def _apply_gain(world: World, place: Place, values: np.ndarray) -> None:
    """Force -> (1 + change) force, feedback terms included."""
    actuators = list(place.actuators)
    world.model.actuator_gainprm[actuators] *= 1 + values[0]
    world.model.actuator_biasprm[actuators] *= 1 + values[0]


def _report(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("change", "1", -0.5, 1.0, 0.03, 0.05),)


def _apply_report(world: World, place: Place, values: np.ndarray) -> None:
    """Reported force = (1 + change) force: a torque constant that is not known well."""
    world.report[list(place.actuators)] *= 1 + values[0]


def _offset_joints(model: mujoco.MjModel) -> list[Place]:
    """Joints that an actuator drives whose force is affine in command and state."""
    linear = {a for place in linear_actuators(model) for a in place.actuators}
    joints = {joint_of(model, a) for a in linear if model.actuator_gear[a, 0] != 0} - {None}
    return joint_places(model, [j for j in joints if j is not None])


def _offset_torque(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    size = typical_scale(scales.torque, place, model)
    return (Parameter("torque", unit_of(model, place, "N m", "N"), -0.8 * size, 0.8 * size, 0.02 * size),)


def _apply_offset_torque(world: World, place: Place, values: np.ndarray) -> None:
    """Tau = c at the joint: an amplifier's offset, an unbalanced spring, friction that depends on direction."""
    model = world.model
    first = {joint_of(model, a): a for a in reversed(place.actuators)}
    for joint in place.joints if values[0] else ():
        a = first[joint]
        if model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE:
            model.actuator_biastype[a] = mujoco.mjtBias.mjBIAS_AFFINE
            model.actuator_biasprm[a] = 0.0
        model.actuator_biasprm[a, 0] += values[0] / model.actuator_gear[a, 0]


def _limit(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    actuators, unit = list(place.actuators), unit_of(model, place, "N m", "N")
    peak = float(scales.force[actuators].max())
    limited = model.actuator_forcelimited[actuators].astype(bool)
    if limited.all():
        believed = float(np.abs(model.actuator_forcerange[actuators]).max())
        if believed <= peak * 1.01:  # the believed limit is reached: it may be larger or smaller
            return (Parameter("limit", unit, _MIN_LIMIT * peak, 3.0 * believed, -0.1 * believed, null=believed),)
    peak = max(peak, 1e-9)
    return (Parameter("limit", unit, _MIN_LIMIT * peak, 1.1 * peak, -0.3 * peak, null=1.1 * peak),)


def _apply_limit(world: World, place: Place, values: np.ndarray) -> None:
    """|force| <= limit at the actuator, such as a current limit [N m before the gear, N for slides]."""
    actuators = list(place.actuators)
    world.model.actuator_forcelimited[actuators] = 1
    world.model.actuator_forcerange[actuators] = (-values[0], values[0])


def _rate(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    peak = max(1.1 * float(scales.command_rate[place.controls(model)].max()), 1e-9)
    joints = {joint_of(model, a) for a in place.actuators}
    # The command of a position servo is an angle where the gear is 1.
    servos = None not in joints and (model.actuator_biasprm[list(place.actuators), 1] < 0).all()
    unit = f"{unit_of(model, place, 'rad', 'm')}/s" if servos else "1/s"
    return (Parameter("limit", unit, _MIN_LIMIT * peak, peak, -0.3 * peak, null=peak),)


def _apply_rate(world: World, place: Place, values: np.ndarray) -> None:
    """|du/dt| <= limit: the drive follows the command no faster, as with a profile velocity of servos."""
    rate = np.full(world.model.nu, np.inf)
    rate[place.controls(world.model)] = values[0]
    world.command_edits.append(partial(Command.rate_limited, rate=rate))


ACTUATOR_DELAY = Effect(
    "actuator_delay",
    _controlled,
    _delay,
    _apply_delay,
    excited_by="commands of several frequencies",
    summable=True,
    native=_native_delay,
    equation="u(t) = command(t − delay)",
)
ACTUATOR_LAG = Effect(
    "actuator_lag",
    _controlled,
    _lag,
    _apply_lag,
    excited_by="commands of several frequencies",
    summable=True,
    native=_native_lag,
    equation="T u̇ = command − u",
)
ACTUATOR_GAIN = per_member(
    Effect(
        "actuator_gain",
        linear_actuators,
        lambda *_: (Parameter("change", "1", -0.9, 9.0, -0.03, 0.003),),
        _apply_gain,
        excited_by="loads and accelerations",
        summable=True,
        equation="force → (1 + change) force",
    )
)
TORQUE_CONSTANT = Effect(
    "torque_constant",
    lambda model: [place for place in actuator_places(model) if not place.members],
    _report,
    _apply_report,
    excited_by="loads and accelerations",
    equation="reported force = (1 + change) force",
)
"""Calibration of drives that report their forces; no robot lacks it."""
OFFSET_TORQUE = per_member(
    Effect(
        "offset_torque",
        _offset_joints,
        _offset_torque,
        _apply_offset_torque,
        excited_by="slow motion in both directions",
        summable=True,
        equation="τ = c",
    )
)
COMMAND_RATE_LIMIT = Effect(
    "command_rate_limit",
    _controlled,
    _rate,
    _apply_rate,
    excited_by="the fastest commands",
    saturates=True,
    equation="|du/dt| ≤ limit",
)
TORQUE_LIMIT = Effect(
    "torque_limit",
    actuator_places,
    _limit,
    _apply_limit,
    excited_by="the largest forces that the actuator is asked for",
    saturates=True,
    equation="|force| ≤ limit",
)

ACTUATOR_EFFECTS = (ACTUATOR_DELAY, ACTUATOR_LAG, COMMAND_RATE_LIMIT, ACTUATOR_GAIN, OFFSET_TORQUE, TORQUE_LIMIT)
