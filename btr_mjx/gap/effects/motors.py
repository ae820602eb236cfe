"""Effects of drives: the torque-speed line, strength that fades, the stiffness of a servo."""

from dataclasses import replace

import mujoco
import numpy as np

from btr_mjx.gap.effects.actuators import linear_actuators
from btr_mjx.gap.effects.effect import Effect, Parameter
from btr_mjx.gap.effects.per_member import per_member
from btr_mjx.gap.effects.places import Place, actuator_count, actuator_places, joint_of
from btr_mjx.gap.effects.ranges import Scales, unit_of
from btr_mjx.gap.simulate import Rows, StateLaw, World

_FASTEST = 3.0
"""No-load speed above which a line is not tried, in peak speeds of the joint."""

_SLOWEST = 0.1
"""Smallest no-load speed, in the same unit."""

_SOFTEST = -0.99
"""Largest loss of a servo's stiffness: gains of hobby servos in models are often fifty times too large."""


def _narrow_limits(
    rows: Rows, actuators: np.ndarray, dofs: np.ndarray, turn: np.ndarray, speed: float, stall: float | None
) -> None:
    """Force limits that fall linearly with the speed in the direction of the force, down to zero.

    `turn` is the sign of each actuator's gear; the stall torque limits actuators that have no limit at rest.
    """
    part = turn * rows.qvel[:, dofs] / speed
    limits, limited = rows.field("actuator_forcerange"), rows.field("actuator_forcelimited")
    if stall is not None:
        own = np.where(limited[:, actuators, None] != 0, limits[:, actuators], [-np.inf, np.inf])
        limits[:, actuators] = np.clip(own, -stall, stall)
        limited[:, actuators] = 1
    limits[:, actuators, 0] *= np.clip(1 + part, 0.0, 1.0)
    limits[:, actuators, 1] *= np.clip(1 - part, 0.0, 1.0)


def _lines(model: mujoco.MjModel) -> list[Place]:
    """Actuators of joints, and their groups."""
    own = [a for a in range(actuator_count(model)) if joint_of(model, a) is not None and model.actuator_gear[a, 0]]
    return actuator_places(model, own)


def _limited(model: mujoco.MjModel, place: Place) -> bool:
    return bool(model.actuator_forcelimited[list(place.actuators)].all())


def _line(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    joints = [j for a in place.actuators if (j := joint_of(model, a)) is not None]
    peak = float(scales.speed[model.jnt_dofadr[joints]].max())
    driven = Place(place.label, joints=tuple(joints))
    speed = Parameter(
        "no_load_speed",
        unit_of(model, driven, "rad/s", "m/s"),
        _SLOWEST * peak,
        _FASTEST * peak,
        -0.3 * peak,
        null=_FASTEST * peak,
    )
    if _limited(model, place):
        return (speed,)
    force = max(float(scales.force[list(place.actuators)].max()), 1e-9)
    unit = unit_of(model, driven, "N m", "N")
    return (speed, Parameter("stall_torque", unit, 0.02 * force, 3.0 * force, -0.1 * force, null=force, shape=True))


def _apply_line(world: World, place: Place, values: np.ndarray) -> None:
    """|force| <= stall (1 - v / no_load_speed) along the motion; the stall torque is the force limit of the model.

    Where the model has no limit, the stall torque is a second number [N m before the gear, N for slides].
    """
    model, actuators = world.model, np.array(place.actuators, int)
    dofs = model.jnt_dofadr[model.actuator_trnid[actuators, 0]].astype(int)
    turn = np.sign(model.actuator_gear[actuators, 0])
    stall = float(values[1]) if len(values) > 1 else None
    fields = "actuator_forcerange", "actuator_forcelimited"
    world.laws.append(StateLaw(_narrow_limits, (actuators, dofs, turn, float(values[0]), stall), fields))


_STRENGTH = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")


def _drift(rows: Rows, actuators: np.ndarray, rate: float) -> None:
    """Strength that drifts linearly with the time since the start of the recording, force limits included."""
    left = np.maximum(1 + rate * rows.time, 0.0)[:, None, None]
    for name in _STRENGTH:
        rows.field(name)[:, actuators] *= left


def _rate(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    most = 0.1 / scales.time
    return (Parameter("rate", "1/s", -most, most, -0.02 * most),)


def _apply_rate(world: World, place: Place, values: np.ndarray) -> None:
    """Force -> (1 + rate t) force, t since the start of the recording: motor heating, battery discharge."""
    world.laws.append(StateLaw(_drift, (np.array(place.actuators, int), float(values[0])), _STRENGTH))


def _servos(model: mujoco.MjModel) -> list[Place]:
    """Position servos with damping, and their groups; without damping a change of stiffness is one of the gain."""
    linear = {a for place in linear_actuators(model) for a in place.actuators}
    damped = [a for a in sorted(linear) if model.actuator_biasprm[a, 1] < 0 and model.actuator_biasprm[a, 2] < 0]
    return actuator_places(model, damped)


def _apply_stiffness(world: World, place: Place, values: np.ndarray) -> None:
    """Kp -> (1 + change) kp, kv as it was: a controller whose gains are not those that are believed."""
    actuators = list(place.actuators)
    world.model.actuator_gainprm[actuators, 0] *= 1 + values[0]
    world.model.actuator_biasprm[actuators, 1] *= 1 + values[0]


SERVO_STIFFNESS = per_member(
    Effect(
        "servo_stiffness",
        _servos,
        lambda *_: (Parameter("change", "1", _SOFTEST, 9.0, -0.03, 0.003),),
        _apply_stiffness,
        excited_by="commands of several frequencies, and loads",
        summable=True,
        saturates=True,
        equation="kp → (1 + change) kp",
    )
)
_LINE = per_member(
    Effect(
        "torque_speed",
        _lines,
        _line,
        _apply_line,
        excited_by="fast motion under large forces",
        summable=True,
        saturates=True,
        equation="|force| ≤ stall (1 − v / no-load speed), along the motion",
    )
)


def _line_places(model: mujoco.MjModel) -> list[Place]:
    """Single actuators, and groups of which all or none have a limit; numbers of their own need one."""
    found = []
    for place in _LINE.places(model):
        limited = model.actuator_forcelimited[list(place.actuators)]
        if limited.all() or not (limited.any() or place.parts):
            found.append(place)
    return found


TORQUE_SPEED = replace(_LINE, places=_line_places)
FADING_MOTOR = Effect(
    "fading_motor",
    linear_actuators,
    _rate,
    _apply_rate,
    excited_by="loads, early and late in long recordings",
    summable=True,
    equation="force → (1 + rate t) force",
)

MOTOR_EFFECTS = (TORQUE_SPEED, FADING_MOTOR, SERVO_STIFFNESS)
