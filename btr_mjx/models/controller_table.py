"""The [controller] table of a robot.toml: a built-in signal with shared parameters, or a function of one's own.

Every motor, or every group of motors, has its own parameters. Ranges that are not given follow from the actuators'
ctrlrange around the controls at the start.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.models.path_parameters import read_bounds
from btr_mjx.models.paths import nearest_names, part_names, refuse_unknown_keys
from btr_mjx.robots import Box, Signal, Sinusoids, Spline
from btr_mjx.runs import is_number, load_object, toml_rows

_COMMON = ("signal", "group")
_KEYS: Mapping[str, tuple[str, ...]] = {
    "sinusoid": ("frequency", "amplitude", "phase", "offset"),
    "spline": ("knots", "range"),
    "": ("parameter",),
}
_GROUP_KEYS = ("name", "motors", "sign", "shift", "amplitude", "phase", "offset", "range")


@dataclass(frozen=True)
class _Group:
    """Motors with the same parameters.

    Attributes:
      name: for the parameters' names.
      motors: ids of the actuators.
      sign: of each, 1 or -1.
      shift: fixed phase of each [rad].
      ranges: ranges of its own, by key.
    """

    name: str
    motors: tuple[int, ...]
    sign: tuple[float, ...]
    shift: tuple[float, ...]
    ranges: Mapping[str, Any]


def read_controller(
    table: Mapping[str, Any], model: mujoco.MjModel, start: np.ndarray, duration: float, file: Path
) -> tuple[Box, Signal]:
    """The controller space and the reference signal of a [controller] table.

    `start` (nu,) are the controls that hold the robot at its start; the file is for messages and for files beside it.

    Raises:
      InputError: unknown keys or motors, ranges that are neither given nor follow from the model, a function whose
        result has a wrong shape.
    """
    where = f"{file}: [controller]"
    kind = table.get("signal")
    if not isinstance(kind, str) or (kind not in _KEYS and ".py:" not in kind):
        raise InputError(f'{where}: signal = {kind!r}: expected "sinusoid", "spline" or "FILE.py:FUNCTION"')
    known = (*_COMMON, *_KEYS.get(kind, _KEYS[""]))
    refuse_unknown_keys(table, known, where)
    if ".py:" in kind:
        return _own_signal(table, kind, model, file)
    if model.nu == 0 or np.any(model.actuator_ctrlnum != 1):
        raise InputError(
            f"{where}: the model has {model.nactuator} motors with {model.nu} controls; a built-in signal "
            "needs motors with one control each, use a signal of your own (FILE.py:FUNCTION)"
        )
    groups = _groups(table, model, file)
    if kind == "sinusoid":
        return _sinusoids(table, groups, model, start, where)
    return _spline(table, groups, model, start, duration, where)


def controls_at_start(model: mujoco.MjModel, keyframe: str) -> np.ndarray:
    """(nu,) controls that hold the robot at its start: those of the keyframe, or the joints' references of servos."""
    if keyframe:
        return model.key(keyframe).ctrl.copy()
    out = np.zeros(model.nu)
    for a in range(model.nactuator):
        servo = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE and model.actuator_biasprm[a, 1] < 0
        if servo and model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT:
            joint = int(model.actuator_trnid[a, 0])
            out[model.actuator_ctrladr[a]] = model.actuator_gear[a, 0] * model.qpos0[model.jnt_qposadr[joint]]
    limited = model.actuator_ctrllimited.astype(bool)
    return np.where(limited, np.clip(out, *model.actuator_ctrlrange.T), out)


def _groups(table: Mapping[str, Any], model: mujoco.MjModel, file: Path) -> list[_Group]:
    """Groups of [[controller.group]], and every other motor as a group of its own."""
    names = part_names(model, "actuator")
    groups, taken = [], dict[int, str]()
    for i, row in enumerate(toml_rows(table, "group", file), 1):
        where = f"{file}: [[controller.group]] {i}"
        refuse_unknown_keys(row, _GROUP_KEYS, where)
        motors = row.get("motors")
        if not isinstance(motors, list) or not motors:
            raise InputError(f"{where}: motors = {motors!r}: expected a list of actuators")
        for motor in motors:
            if motor not in names:
                raise InputError(
                    f"{where}: the model has no motor {motor!r}; nearest: {nearest_names(str(motor), names)}"
                )
            if names.index(motor) in taken:
                raise InputError(f"{where}: motor {motor!r} is in group {taken[names.index(motor)]!r} already")
        label = str(row.get("name", motors[0]))
        taken |= {names.index(motor): label for motor in motors}
        sign, shift = (
            _each(row.get(key, [value] * len(motors)), len(motors), f"{where}: {key}")
            for key, value in (("sign", 1.0), ("shift", 0.0))
        )
        if any(abs(s) != 1 for s in sign):
            raise InputError(f"{where}: sign = {row['sign']!r}: expected 1 or -1 for each motor")
        groups.append(_Group(label, tuple(names.index(motor) for motor in motors), sign, shift, row))
    rest = [_Group(name, (i,), (1.0,), (0.0,), {}) for i, name in enumerate(names) if i not in taken]
    return [*groups, *rest]


def _each(value: Any, count: int, what: str) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != count or not all(is_number(v) for v in value):
        raise InputError(f"{what} = {value!r}: expected {count} numbers, one for each motor")
    return tuple(float(v) for v in value)


def _room(group: _Group, model: mujoco.MjModel, start: np.ndarray) -> float | None:
    """Largest amplitude that all motors of a group have within their ctrlrange; None where one has none."""
    room = []
    for motor in group.motors:
        if not model.actuator_ctrllimited[motor]:
            return None
        low, high = model.actuator_ctrlrange[motor]
        centre = start[model.actuator_ctrladr[motor]]
        room.append(min(high - centre, centre - low))
    return float(min(room))


def _range(
    key: str, table: Mapping[str, Any], group: _Group, default: tuple[float, float] | None, where: str
) -> tuple[float, float]:
    value = group.ranges.get(key, table.get(key))
    if value is not None:
        return read_bounds({"bounds": value}, f"{where}: {key} of {group.name!r}")
    if default is None or not default[0] < default[1]:
        raise InputError(
            f"{where}: motor {group.name!r} has no ctrlrange around its start that {key} could follow from; write "
            f"{key} = [LOW, HIGH]"
        )
    return default


def _by_motor(groups: list[_Group], values: list[tuple[float, ...]]) -> tuple[float, ...]:
    """Numbers of all groups in the order of the motors."""
    pairs = [pair for group, own in zip(groups, values, strict=True) for pair in zip(group.motors, own, strict=True)]
    return tuple(value for _, value in sorted(pairs))


def _sinusoids(
    table: Mapping[str, Any], groups: list[_Group], model: mujoco.MjModel, start: np.ndarray, where: str
) -> tuple[Box, Signal]:
    rows: list[tuple[str, float, float, str]] = []
    frequency: Any = table.get("frequency")
    if isinstance(frequency, list):
        rows.append(("frequency", *read_bounds({"bounds": frequency}, f"{where}: frequency"), "Hz"))
    elif not is_number(frequency) or not frequency > 0:
        raise InputError(f"{where}: frequency = {frequency!r}: expected a number of Hz, or [LOW, HIGH]")
    index: dict[str, dict[int, int]] = {"amplitude": {}, "phase": {}, "offset": {}}
    for group in groups:
        room = _room(group, model, start)
        ranges = {
            "amplitude": _range("amplitude", table, group, None if room is None else (0.0, room), where),
            "phase": _range("phase", table, group, (0.0, 2 * math.pi), where),
        }
        if "offset" in table or "offset" in group.ranges:
            ranges["offset"] = _range("offset", table, group, None, where)
        for key, (low, high) in ranges.items():
            for motor in group.motors:
                index[key][motor] = len(rows)
            rows.append((f"{key} {group.name}", low, high, "rad" if key == "phase" else ""))
    motors = range(model.nu)
    offset = index["offset"]
    if offset and len(offset) < model.nu:
        raise InputError(f"{where}: offset is given for some groups only; give [controller] an offset, or every group")
    signal = Sinusoids(
        amplitude=tuple(index["amplitude"][m] for m in motors),
        phase=tuple(index["phase"][m] for m in motors),
        offset=tuple(offset[m] for m in motors) if offset else (),
        frequency=0 if isinstance(frequency, list) else -1,
        hertz=1.0 if isinstance(frequency, list) else float(frequency),
        centre=tuple(start.tolist()),
        sign=_by_motor(groups, [group.sign for group in groups]),
        shift=_by_motor(groups, [group.shift for group in groups]),
    )
    return _box(rows), signal


def _spline(
    table: Mapping[str, Any],
    groups: list[_Group],
    model: mujoco.MjModel,
    start: np.ndarray,
    duration: float,
    where: str,
) -> tuple[Box, Signal]:
    count = table.get("knots")
    if not isinstance(count, int) or isinstance(count, bool) or not 2 <= count <= 100:
        raise InputError(f"{where}: knots = {count!r}: expected a number of knots for each motor, from 2 to 100")
    rows: list[tuple[str, float, float, str]] = []
    knots: dict[int, tuple[int, ...]] = {}
    for group in groups:
        room = _room(group, model, start)
        low, high = _range("range", table, group, None if room is None else (-room, room), where)
        knots |= {motor: tuple(range(len(rows), len(rows) + count)) for motor in group.motors}
        rows += [(f"knot {k + 1} {group.name}", low, high, "") for k in range(count)]
    motors = range(model.nu)
    sign = _by_motor(groups, [group.sign for group in groups])
    signal = Spline(tuple(knots[m] for m in motors), duration, tuple(start.tolist()), sign)
    return _box(rows), signal


def _own_signal(table: Mapping[str, Any], kind: str, model: mujoco.MjModel, file: Path) -> tuple[Box, Signal]:
    rows = []
    for i, row in enumerate(toml_rows(table, "parameter", file), 1):
        where = f"{file}: [[controller.parameter]] {i}"
        refuse_unknown_keys(row, ("name", "bounds", "low", "high", "unit"), where)
        if not isinstance(row.get("name"), str):
            raise InputError(f"{where}: name = {row.get('name')!r}: expected a text")
        rows.append((row["name"], *read_bounds(row, where), str(row.get("unit", ""))))
    if not rows:
        raise InputError(f"{file}: a signal of one's own needs at least one [[controller.parameter]]")
    own, _, attribute = kind.rpartition(":")
    signal = load_object(f"{(file.parent / own).resolve()}:{attribute}", "signal")
    box = _box(rows)
    middle = 0.5 * (box.low + box.high)[:, None].repeat(2, axis=1)
    try:
        found = np.asarray(signal(middle, 0.1, np))
    except Exception as error:
        raise InputError(f"{file}: signal {kind!r} fails: {type(error).__name__}: {error}") from error
    if found.shape != (model.nu, 2) or not np.isfinite(found).all():
        raise InputError(
            f"{file}: signal {kind!r}: for controllers ({box.n}, 2) it gave shape {found.shape}, expected finite "
            f"numbers ({model.nu}, 2): one row for each control of the model"
        )
    return box, signal


def _box(rows: list[tuple[str, float, float, str]]) -> Box:
    names, low, high, units = zip(*rows, strict=True)
    return Box(names, low, high, units=units)
