"""Units of columns: what a name or a row of units states, and what the interval of time stamps tells.

Only units that are written down are converted, and those of time stamps, which their interval gives away. Whether
numbers without a unit look like degrees or millimetres is for preflight to ask.

A unit in dataset.toml may have a number: "turn/4096" are the ticks of an encoder, "0.48 Nm/A" amperes with a torque
constant, "-rad" an angle that counts the other way round.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import SENSOR_QUANTITIES, sensor_parts
from btr_mjx.gap.data.columns.words import ACCELERATION, words
from btr_mjx.models import part_names

TIME_UNITS: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds by unit of time."""

UNITS: Mapping[str, tuple[str, float]] = {
    **{unit: ("time", seconds) for unit, seconds in TIME_UNITS.items()},
    "rad": ("angle", 1.0),
    "deg": ("angle", math.pi / 180),
    "turn": ("angle", 2 * math.pi),
    "m": ("length", 1.0),
    "cm": ("length", 1e-2),
    "mm": ("length", 1e-3),
    "rad/s": ("turning", 1.0),
    "deg/s": ("turning", math.pi / 180),
    "turn/s": ("turning", 2 * math.pi),
    "rpm": ("turning", 2 * math.pi / 60),
    "m/s": ("moving", 1.0),
    "cm/s": ("moving", 1e-2),
    "mm/s": ("moving", 1e-3),
    "m/s^2": ("acceleration", 1.0),
    "g": ("acceleration", 9.80665),
    "nm": ("force", 1.0),
    "mnm": ("force", 1e-3),
    "n": ("force", 1.0),
    "mn": ("force", 1e-3),
}
"""Quantity and SI units per unit, by unit."""

_SPELLINGS: Mapping[str, str] = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds", "millis"), "ms"),
    **dict.fromkeys(("µs", "μs", "usec", "usecs", "microsecond", "microseconds", "micros"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanosecond", "nanoseconds", "nanos"), "ns"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("°", "degs", "degree", "degrees"), "deg"),
    **dict.fromkeys(("turns", "rev", "revs", "revolution", "revolutions"), "turn"),
    **dict.fromkeys(("turns/s", "turn/sec", "turns/sec", "rev/s", "revs/s", "rev/sec", "rps"), "turn/s"),
    **dict.fromkeys(("rad/sec", "rads", "radps", "rad*s-1", "rad s-1"), "rad/s"),
    **dict.fromkeys(("°/s", "deg/sec", "degs/s", "dps", "degree/s", "degrees/s"), "deg/s"),
    **dict.fromkeys(("1/min", "rev/min", "u/min"), "rpm"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("m/s2", "m/s²", "m/s**2", "m/s/s", "mps2", "ms2"), "m/s^2"),
    **dict.fromkeys(("n m", "n*m", "n·m", "n.m", "newton metre"), "nm"),
}
_OTHER = ("", "-", "1", "a", "ma", "v", "mv", "w", "%", "c", "°c", "degc", "k", "hz", "pa", "bar", "kg", "count")
"""What else may stand in a row of units: nothing is converted there."""

_AS_SUFFIX = (
    *("deg", "degrees", "rad", "turns", "revolutions", "mm", "cm", "rpm", "dps"),
    *("sec", "secs", "ms", "msec", "us", "usec", "ns", "nsec"),
)
"""Units that the last word of a name may be; shorter ones are too often something else."""
_A_SECOND = re.compile(r"(.+?)[\s_./-]+((?:deg|rad|turns?|revs?)[/_]s|m[/_]s(?:\^2|2|²)|mps2|ms2)", re.IGNORECASE)
"""Rates at the end of a name."""

_TYPICAL = (("s", 0.5), ("ms", 200.0), ("us", 2e5), ("ns", 2e8))
"""Largest typical interval between samples by unit: two seconds^-1 in seconds, five a second in the others."""

_EPOCH = (1e9, 3e9)
"""Seconds since 1970 between 2001 and 2065."""


_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_SCALED = re.compile(
    rf"(?P<sign>[-+]?)\s*(?P<times>{_NUMBER})?\s*\*?\s*(?P<unit>[^\d.\s+-].*?)"
    rf"(?:\s*/\s*(?:a|amps?|amperes?|ticks?|counts?))?(?:\s*/\s*(?P<parts>{_NUMBER}))?",
    re.IGNORECASE,
)
"""A unit with a number before or after it; what is counted, ampere or ticks, may be named."""


@dataclass(frozen=True)
class ColumnUnit:
    """A unit of a column.

    Attributes:
      text: as it was written, for messages.
      quantity: a first entry of `UNITS`.
      factor: to SI units.
    """

    text: str
    quantity: str
    factor: float

    @staticmethod
    def of(text: str) -> "ColumnUnit | None":
        """The unit that a text stands for, with or without a number; None if it is none."""
        if unit := known_unit(text):
            return ColumnUnit(unit, *UNITS[unit])
        found = _SCALED.fullmatch(text.strip())
        unit = known_unit(found["unit"]) if found else None
        if found is None or unit is None:
            return None
        quantity, factor = UNITS[unit]
        parts = float(found["parts"] or 1)
        scale = float(found["times"] or 1) / parts if parts else 0.0
        if not (math.isfinite(scale) and scale > 0):
            return None
        return ColumnUnit(text.strip(), quantity, (-scale if found["sign"] == "-" else scale) * factor)


def known_unit(text: str) -> str | None:
    """The unit that a text stands for, e.g. "[Deg]" for "deg"; None if it is none of `UNITS`."""
    word = text.strip().strip("[](){}<>").strip().lower()
    word = _SPELLINGS.get(word, word)
    return word if word in UNITS else None


def is_unit_text(text: str) -> bool:
    """Whether a field of a row of units may hold this text."""
    return known_unit(text) is not None or text.strip().strip("[](){}").strip().lower() in _OTHER


def stated_unit(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit or None: ("q_hip", "deg") for "q_hip [deg]" and "q_hip_deg"."""
    if match := re.fullmatch(r"(.*\S)\s*[\[(<]([^\[\]()<>]*)[\])>]\s*", name):
        unit = known_unit(match[2])
        if unit or (is_unit_text(match[2]) and not match[2].strip().isdigit()):
            return match[1], unit
    if match := _A_SECOND.fullmatch(name):
        return match[1], known_unit(match[2].replace("_", "/"))
    if match := re.fullmatch(r"(.+?)[\s_./-]+([A-Za-z]+)", name):
        unit = match[2].lower()
        if unit in _AS_SUFFIX or (unit == "g" and ACCELERATION & set(words(match[1]))):
            return match[1], known_unit(unit)
    return name, None


def time_unit(time: np.ndarray) -> str:
    """The unit of time stamps (K,), told by their range (epochs) or else by their interval.

    Stamps that count from 1970 lie between 1e9 and 3e9 seconds, a thousand times that in milliseconds and so on. Others
    are told by the median interval: logs have 2 to 10,000 samples a second.
    """
    time = time[np.isfinite(time)]
    steps = np.abs(np.diff(time))
    steps = steps[steps > 0]
    usual = float(np.median(steps)) if len(steps) else 0.0
    for unit, seconds in TIME_UNITS.items():
        if len(time) and _EPOCH[0] <= time[0] * seconds <= _EPOCH[1] and 1e-5 <= usual * seconds <= 10:
            return unit
    return next((unit for unit, largest in _TYPICAL if usual < largest), "s")


def conversion(column: str, unit: ColumnUnit, model: mujoco.MjModel, where: str) -> float:
    """Factor from a stated unit to that of a column of the model; refuses that of another quantity."""
    expected = quantity_of(column, model)
    if expected is not None and expected != unit.quantity and (expected, unit.quantity) != ("turning", "angle"):
        if column.startswith("ctrl/"):  # commands of other drives have units of their own
            return 1.0
        raise InputError(
            f"{where}: is in {unit.text}, {column!r} needs a unit of {expected}; correct the unit or the name"
        )
    return 1.0 if expected is None else unit.factor  # "velocity_deg" is meant a second


def unit_text(column: str, factor: float, model: mujoco.MjModel) -> str:
    """A unit with this factor to that of a column of the model, as `ColumnUnit.of` reads it; "" where it has none."""
    quantity, size = quantity_of(column, model), abs(factor)
    sign = "-" if factor < 0 else ""
    own = {unit: scale for unit, (kind, scale) in UNITS.items() if kind == quantity}
    hinge = quantity == "force" and _acts_on_hinge(column, model)
    own = {u: f for u, f in own.items() if quantity != "force" or (u in ("nm", "mnm")) == hinge}
    if not own or not size:
        return ""
    spelled = {"nm": "Nm", "mnm": "mNm", "n": "N", "mn": "mN"}
    for unit, scale in own.items():
        if math.isclose(size, scale, rel_tol=1e-6):
            return sign + spelled.get(unit, unit)
    for unit in ("turn", "turn/s"):
        if (
            unit in own
            and (parts := round(own[unit] / size)) > 1
            and math.isclose(size * parts, own[unit], rel_tol=1e-6)
        ):
            return f"{sign}{unit}/{parts}"
    unit = next(unit for unit, scale in own.items() if scale == 1.0)
    return f"{factor:.4g} {spelled.get(unit, unit)}"


def _acts_on_hinge(column: str, model: mujoco.MjModel) -> bool:
    """Whether an actuator, by a column of it, turns a hinge."""
    i = part_names(model, "actuator").index(column.partition("/")[2])
    on_joint = int(model.actuator_trntype[i]) == mujoco.mjtTrn.mjTRN_JOINT
    return on_joint and int(model.jnt_type[model.actuator_trnid[i, 0]]) == mujoco.mjtJoint.mjJNT_HINGE


def commanded(model: mujoco.MjModel, actuator: str) -> str:
    """The quantity that an actuator is commanded: of a servo its position or velocity, else an effort."""
    i = part_names(model, "actuator").index(actuator)
    if model.actuator_biasprm[i, 1] != 0:
        return "position"
    return "velocity" if model.actuator_biasprm[i, 2] != 0 else "effort"


def quantity_of(column: str, model: mujoco.MjModel) -> str | None:
    """Quantity of a column of the model: a first entry of `UNITS`; None if it has no unit or one of its own."""
    kind, _, name = column.partition("/")
    if kind in ("time", "force"):
        return kind
    joints, part, driven = part_names(model, "joint"), "", ""
    if kind == "sensor":
        sensors = part_names(model, "sensor")
        sensor = next((sensors.index(one) for one, own in sensor_parts(model).items() if column in own), None)
        quantity = None if sensor is None else SENSOR_QUANTITIES[int(model.sensor_type[sensor])]
        if sensor is None or quantity not in ("qpos", "qvel"):
            return quantity
        kind, name = quantity, joints[int(model.sensor_objid[sensor])]
    if kind == "ctrl":
        i = part_names(model, "actuator").index(name)
        if int(model.actuator_trntype[i]) != mujoco.mjtTrn.mjTRN_JOINT:
            return "force" if commanded(model, name) == "effort" else None
        name, driven = joints[int(model.actuator_trnid[i, 0])], commanded(model, name)
    elif kind in ("qpos", "qvel"):
        driven = "position" if kind == "qpos" else "velocity"
        name, _, part = (name, "", "") if name in joints else name.rpartition("/")
    else:
        return None
    if part:
        return {"q": None, "w": "turning", "v": "moving"}.get(part[0], "length")
    hinge = name in joints and model.jnt_type[joints.index(name)] == mujoco.mjtJoint.mjJNT_HINGE
    pairs = {"position": ("length", "angle"), "velocity": ("moving", "turning"), "effort": ("force", "force")}
    return pairs[driven][bool(hinge)]


def to_seconds(time: np.ndarray, unit: str | None, notes: list[str]) -> tuple[float, float]:
    """Factor and origin with which time stamps (K,) become seconds: (time - origin) * factor.

    Stamps without a stated unit tell their own.
    """
    found = unit or time_unit(time)
    factor = TIME_UNITS[found]
    finite = time[np.isfinite(time)]
    start = float(finite[0]) * factor if len(finite) else 0.0
    # Keeps the digits of the intervals, and effects may depend on the time since the recording began.
    origin = float(finite[0]) if abs(start) >= 1 else 0.0
    if found != "s":
        reason = "as stated" if unit else f"told by intervals of {np.median(np.abs(np.diff(finite))):.3g}"
        notes.append(f"time stamps are in {found} ({reason}) and were converted to s")
    if origin:
        notes.append(f"time counts from the first sample, at {start:.3f} s")
    return factor, origin
