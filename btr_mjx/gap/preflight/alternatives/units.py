"""Units of positions and commands of hinges and slides, found by what the believed model predicts with each.

A size alone tells little: a joint that moves from -0.2 to 0.2 may do so in radians or in turns. A factor is right where
the model then predicts the motion, and where no other force would explain it as well: the unit of a position is the
same as that of a torque where there is no weight.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.preflight.alternatives.alternative import HINGE_TYPE, SLIDE_TYPE, Alternative, LoggedColumns
from btr_mjx.gap.preflight.findings import DEGREES_REMEDY
from btr_mjx.gap.preflight.predictions import Change

LARGE_ANGLE = 6.0
"""Angles [rad] below which numbers are no encoder counts and no per cent, and single hinges are not asked for degrees:
those are large numbers."""

LARGE_LENGTH = 3.0
"""The same for positions of slides and free joints [m]."""

_COUNTED = (0.05, 4 * np.pi)
"""Angles [rad] between which the farthest position lies that is counted in ticks."""

_POWERS = range(9, 25)
"""Powers of two that encoders count in a turn."""

_BEYOND = 0.2
"""Share of a joint's limits by which a unit may exceed them: limits of models are those of a data sheet."""

_SERVO_REACH = 15.0
"""Angle [rad] that no position servo reaches: more than two turns."""


@dataclass(frozen=True)
class PositionUnit:
    """A unit of positions: SI = scale * value + offset."""

    scale: float
    offset: float
    words: str
    remedy: str


TURNS = (
    PositionUnit(2 * np.pi, 0.0, "turns (2 pi rad)", "angles are in rad: multiply by 2 pi"),
    PositionUnit(np.pi, 0.0, "half turns (pi rad)", "angles are in rad: multiply by pi"),
)
"""Turns and half turns."""
_DEGREES = PositionUnit(np.pi / 180, 0.0, "degrees", DEGREES_REMEDY)


def robot_units(columns: LoggedColumns, hinges: Mapping[int, int]) -> Iterator[Alternative]:
    """Units of all hinges at once, and what else would explain the same factor.

    Args:
      columns: of the dataset.
      hinges: group of each hinge, by id of the joint.
    """
    joints, groups = list(hinges), tuple(hinges.values())
    servos, motors = columns.servos(joints), columns.motors(joints)
    names = f"qpos/{columns.joints[joints[0]]}" if len(joints) == 1 else "the positions of all hinges"
    goals = f"ctrl/{columns.actuators[servos[0]]}" if len(servos) == 1 else "the commands of all servos"
    both = f"{names} and {goals} both:" if len(joints) == 1 else "the positions and commands of all hinges"
    look = "looks like" if len(joints) == 1 else "look like"
    units = [_DEGREES, *TURNS, *_counts(columns, joints)]
    for unit in (unit for unit in units if _possible(columns, joints, unit)):
        qpos = columns.joints_times(joints, unit.scale, unit.offset)
        ctrl = columns.ctrl(servos, unit.scale, unit.offset)
        tried = [(f"{names} {look}", columns.changed(qpos))]
        if servos:
            tried.append((f"{both} {look}", Change(qpos, ctrl)))
            tried.append((f"{goals} {'looks' if len(servos) == 1 else 'look'} like", columns.changed(ctrl=ctrl)))
        for words, change in tried:
            yield Alternative(change, groups, f"{words} {unit.words}", unit.remedy, "units", elsewhere=True)
        if motors:
            weak = columns.changed(ctrl=columns.ctrl(motors, 1 / unit.scale))
            yield Alternative(weak, groups, "", "", "", nuisance=True)


def joint_units(columns: LoggedColumns, joint: int, group: int, poor: bool) -> Iterator[Alternative]:
    """Units of the positions and commands of a hinge or slide; `poor` where the model predicts it badly."""
    name, servos = columns.joints[joint], columns.servos([joint])
    loud = [a for a in servos if columns.command_reach[a] > LARGE_ANGLE]
    large = columns.reach(joint) > (LARGE_ANGLE if columns.model.jnt_type[joint] == HINGE_TYPE else LARGE_LENGTH)
    turns = TURNS if poor and columns.model.jnt_type[joint] == HINGE_TYPE else ()
    for unit in [*turns, *(_large_units(columns, joint) if large or loud else ())]:
        qpos, words = columns.joints_times([joint], unit.scale, unit.offset), f"looks like {unit.words}"
        ctrl = columns.ctrl(servos, unit.scale, unit.offset)
        if (large or unit in turns) and _possible(columns, [joint], unit):
            alone = columns.changed(qpos)
            yield Alternative(alone, (group,), f"qpos/{name} {words}", unit.remedy, "units", elsewhere=True)
            if servos:
                text = f"qpos/{name} and ctrl/{columns.actuators[servos[0]]} both: {words}"
                yield Alternative(Change(qpos, ctrl), (group,), text, unit.remedy, "units", elsewhere=True)
        if loud and unit not in turns:
            goals = columns.changed(ctrl=columns.ctrl(loud, unit.scale, unit.offset))
            yield Alternative(goals, (group,), f"ctrl/{columns.actuators[loud[0]]} {words}", unit.remedy, "units")
    for a in columns.motors([joint]):
        for scale, words, remedy in _command_units(columns, a) if columns.command_reach[a] > 0 else ():
            command = columns.changed(ctrl=columns.ctrl([a], scale))
            yield Alternative(command, (group,), f"ctrl/{columns.actuators[a]} {words}", remedy, "units")
        for unit in turns:
            weak = columns.changed(ctrl=columns.ctrl([a], 1 / unit.scale))
            yield Alternative(weak, (group,), "", "", "", nuisance=True)


def _possible(columns: LoggedColumns, joints: Sequence[int], unit: PositionUnit) -> bool:
    """Whether positions of joints would stay where their limits, and servos without limits, allow."""
    model = columns.model
    for joint in joints:
        q = int(model.jnt_qposadr[joint])
        low, high = sorted(unit.scale * x + unit.offset for x in (columns.low[q], columns.high[q]))
        if model.jnt_limited[joint]:
            bottom, top = map(float, model.jnt_range[joint])
            room = _BEYOND * (top - bottom)
            if low < bottom - room or high > top + room:
                return False
        elif columns.servos([joint]) and model.jnt_type[joint] == HINGE_TYPE and max(-low, high) > _SERVO_REACH:
            return False
    return True


def _counts(columns: LoggedColumns, joints: Sequence[int]) -> Iterator[PositionUnit]:
    """Counts of encoders, a power of two a turn, with 0 or half a turn where the model's joint is at 0."""
    farthest = max(map(columns.reach, joints))
    positive = all(columns.low[columns.model.jnt_qposadr[joint]] >= 0 for joint in joints)
    for count in (2**power for power in _POWERS) if farthest > LARGE_ANGLE else ():
        scale, words = 2 * np.pi / count, f"encoder counts, {count} a turn"
        if _COUNTED[0] <= farthest * scale <= _COUNTED[1]:
            yield PositionUnit(scale, 0.0, words, f"multiply by 2 pi / {count}")
            if positive:
                middle = count // 2
                remedy = f"subtract {middle}, then multiply by 2 pi / {count}"
                yield PositionUnit(scale, -np.pi, f"{words} with {middle} in the middle", remedy)


def _large_units(columns: LoggedColumns, joint: int) -> Iterator[PositionUnit]:
    """Units of a joint's positions that have large numbers."""
    if columns.model.jnt_type[joint] == SLIDE_TYPE:
        yield PositionUnit(1e-3, 0.0, "millimetres", "positions of slides are in m: divide by 1000")
        yield PositionUnit(1e-2, 0.0, "centimetres", "positions of slides are in m: divide by 100")
    else:
        yield _DEGREES
        yield from _counts(columns, [joint])
    if columns.model.jnt_limited[joint]:
        low, high = map(float, columns.model.jnt_range[joint])
        ends = f"{low:.4g} to {high:.4g}"
        yield PositionUnit((high - low) / 100, low, "per cent of its range", f"0 to 100 is {ends}")
        words = "its range counted from -100 to 100"
        yield PositionUnit((high - low) / 200, (low + high) / 2, words, f"-100 to 100 is {ends}")


def _command_units(columns: LoggedColumns, a: int) -> Iterator[tuple[float, str, str]]:
    """Factor, words and remedy of units of a motor's or velocity servo's command."""
    model = columns.model
    if float(model.actuator_biasprm[a, 2]) < 0:
        yield np.pi / 180, "looks like degrees/s", "velocities are in rad/s: divide by 57.3"
        yield 2 * np.pi / 60, "looks like revolutions per minute", "multiply by 0.10472"
        yield 2 * np.pi, "looks like turns/s", "velocities are in rad/s: multiply by 2 pi"
    yield 1e-3, "looks like thousandths of its unit (mN m, mN)", "divide by 1000"
    yield 1e-2, "looks like per cent", "divide by 100"
    if model.actuator_ctrllimited[a]:
        high = float(np.abs(model.actuator_ctrlrange[a]).max())
        if high not in (0.0, 1.0, 100.0) and columns.command_reach[a] > 1.5 * high:
            yield high / 100, "looks like per cent of its ctrlrange", f"100 is {high:.4g}"
