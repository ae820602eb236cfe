"""What the numbers of a LeRobot dataset are worth: unit, sign and zero of each joint, found or declared.

LeRobot writes degrees from the middle of a joint's calibrated range, or that range counted from -100 to 100, without
saying which; a gripper is its range from 0 to 100. A servo's encoder has 4096 counts a turn. The smallest step of the
values is therefore 360/4096 in degrees, the same for all joints, and 200 / (counts of the calibrated range) otherwise,
from which that range follows. Where there are no such steps, the sizes of the values and the joint's limits decide.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.remedy import quoted
from btr_mjx.gap.data.columns.words import words
from btr_mjx.gap.data.lerobot.joints import heading, short
from btr_mjx.gap.data.lerobot.steps import COUNTS, counted_step
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import part_names
from btr_mjx.runs import check_keys, is_number

SPANS: Mapping[str, tuple[float, float]] = {"range": (-100.0, 100.0), "percent": (0.0, 100.0)}
"""Values at the two ends of a joint's range, by unit."""
FACTORS: Mapping[str, float] = {"deg": np.pi / 180, "rad": 1.0, "m": 1.0}
"""To SI units."""
JOINT_KEYS = ("joint", "unit", "sign", "zero", "range")
"""Keys of a table [lerobot.joints.NAME]."""

_GRIPPERS = {"gripper", "jaw", "claw", "hand", "finger"}
"""Words in names of numbers that LeRobot counts from 0 to 100."""
_PERCENT = (-10.0, 110.0)
"""Values that LeRobot lets through as per cent."""
_LARGEST_RAD = 6.4
"""Angle that no joint of an arm exceeds; values below it are too small for degrees if all joints have such."""
_SHARES = (190 / COUNTS, 1.0)
"""Steps of a range of at most a turn and at least 200 counts, counted from -100 to 100."""
_SLACK = np.radians(6.0)
"""How far a joint may seem to pass its limits: calibrations are by hand [rad]."""
_INSIDE = 0.995
"""Share of the samples that has to lie inside a joint's limits."""


@dataclass(frozen=True)
class JointScale:
    """How the numbers of a joint become its position.

    Attributes:
      name: of the number in the dataset.
      joint: of the model.
      unit: "deg", "rad", "m", "range" (-100 to 100) or "percent" (0 to 100).
      sign: -1 where the numbers count the other way round.
      zero: value at which the model's joint is at 0, of "deg", "rad" and "m".
      ends: positions [rad] or [m] at the two ends of "range" and "percent".
    """

    name: str
    joint: str
    unit: str
    sign: int = 1
    zero: float = 0.0
    ends: tuple[float, float] = (0.0, 0.0)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Positions (N,) [rad] or [m] from values (N,) of the dataset."""
        if self.unit in FACTORS:
            return self.sign * FACTORS[self.unit] * (values - self.zero)
        (first, last), (low, high) = SPANS[self.unit], self.ends if self.sign > 0 else self.ends[::-1]
        return low + (values - first) / (last - first) * (high - low)

    @property
    def heading(self) -> str:
        """The line of dataset.toml that begins the joint's table."""
        return heading(self.name)

    @property
    def zero_key(self) -> str:
        """The key of that table that says where 0 is."""
        return "zero" if self.unit in FACTORS else "range"

    def lines(self) -> list[str]:
        """The table of dataset.toml that says this."""
        own = [f"joint = {quoted(self.joint)}", f"unit = {quoted(self.unit)}", f"sign = {self.sign}"]
        zero = f"{self.zero:.6g}" if self.unit in FACTORS else f"[{self.ends[0]:.6g}, {self.ends[1]:.6g}]"
        return [self.heading, *own, f"{self.zero_key} = {zero}"]


def check_scale(table: Mapping[str, Any], where: str, notes: list[str]) -> None:
    """Refuse misspelt keys and invalid values in a table [lerobot.joints.NAME]."""
    check_keys(table, JOINT_KEYS, where, notes)
    known = (*FACTORS, *SPANS)
    ends = table.get("range", [0.0, 1.0])
    for key, good, expected in (
        ("joint", isinstance(table.get("joint", ""), str), 'the name of a joint, or "" for none'),
        ("unit", table.get("unit", "deg") in known, f"one of {', '.join(known)}"),
        ("sign", table.get("sign", 1) in (1, -1) and not isinstance(table.get("sign"), bool), "1 or -1"),
        ("zero", is_number(table.get("zero", 0.0)), "the value at which the model's joint is at 0"),
        (
            "range",
            isinstance(ends, list) and len(ends) == 2 and all(map(is_number, ends)) and ends[0] != ends[1],
            "the positions at -100 and 100 (percent: 0 and 100) [rad] or [m], two different numbers",
        ),
    ):
        if not good:
            raise InputError(f"{where}: {key} = {table[key]!r}: expected {expected}")


def find_scales(
    values: Mapping[str, np.ndarray],
    joints: Mapping[str, int],
    model: mujoco.MjModel,
    tables: Mapping[str, Mapping[str, Any]],
    unit: str | None,
    where: str,
    notes: list[str],
) -> dict[str, JointScale]:
    """Unit, sign and zero of each number.

    Args:
      values: (N,) states of all episodes, by name of the number.
      joints: ids of joints by name.
      model: the model.
      tables: what dataset.toml says, by `short` name; what is absent is found.
      unit: of all numbers without one of their own; None if it is to be found.
      where: dataset.toml, for messages.
      notes: choices are appended here; those that the data do not support begin with "assumed".

    Raises:
      InputError: a joint without limits whose values are a share of its range, or a unit that does not fit.
    """
    stated = {name: tables.get(short(name), {}) for name in joints}
    left = [name for name in joints if "unit" not in stated[name]]
    steps = {name: counted_step(values[name]) for name in joints}
    grippers = [n for n in left if _GRIPPERS & set(words(n)) and _between(values[n], *_PERCENT)]
    others = {name: values[name] for name in left if name not in grippers}
    if others and unit is None:
        unit = _common_unit(others, joints, model, steps, where, notes)
    small = max((float(np.abs(own).max()) for own in values.values()), default=0.0) <= _LARGEST_RAD
    units = dict.fromkeys(others, unit or "deg")
    units |= dict.fromkeys(grippers, unit if unit in ("rad", "m") and small else "percent")
    units |= {name: str(table["unit"]) for name, table in stated.items() if "unit" in table}
    return {
        name: _scale(name, joints[name], units[name], stated[name], values[name], steps[name], model, where, notes)
        for name in joints
    }


def _common_unit(
    values: Mapping[str, np.ndarray],
    joints: Mapping[str, int],
    model: mujoco.MjModel,
    steps: Mapping[str, float | None],
    where: str,
    notes: list[str],
) -> str:
    """The unit of all joints but grippers."""
    reach = {name: float(np.abs(own).max()) for name, own in values.items()}
    farthest = max(reach, key=reach.__getitem__)
    known = {name: step for name in values if (step := steps[name]) is not None}
    shares = {name: step for name, step in known.items() if _SHARES[0] < step < _SHARES[1]}
    differ = bool(shares) and max(shares.values()) > 1.005 * min(shares.values())
    degrees = [name for name, step in known.items() if abs(step / (360 / COUNTS) - 1) < 2e-3]
    beyond = [name for name in values if _fitting(values[name], "deg", joints[name], model) is None]
    if reach[farthest] <= _LARGEST_RAD:
        chosen, why = "rad", f"no value is beyond {reach[farthest]:.3g}"
    elif reach[farthest] > SPANS["range"][1] + 0.5:
        chosen, why = "deg", f"{farthest} reaches {reach[farthest]:.4g}"
    elif len(known) and len(degrees) > len(known) / 2:
        chosen, why = "deg", f"values are multiples of 360/{COUNTS}, an encoder's count in degrees"
    elif differ:  # those of rounded numbers are alike
        counts = listed((f"{step:.4g} of {name}" for name, step in shares.items()), 3)
        chosen, why = "range", f"an encoder's steps differ from joint to joint: {counts}"
    elif beyond:
        chosen, why = "range", f"as degrees, {listed(beyond)} would be beyond the joint's limits"
    else:
        notes.append(
            f"assumed: values of the dataset are degrees (they reach {reach[farthest]:.4g} and have no steps of an "
            'encoder, so that they may be shares of the ranges, -100 to 100); if so, write unit = "range" below '
            f"[lerobot] in {where}"
        )
        return "deg"
    words_of = {"rad": "radians", "deg": "degrees", "range": "shares of the joints' ranges, -100 to 100"}
    notes.append(f'values of the dataset are {words_of[chosen]} (unit = "{chosen}"): {why}')
    return chosen


def _scale(
    name: str,
    joint: int,
    unit: str,
    table: Mapping[str, Any],
    values: np.ndarray,
    step: float | None,
    model: mujoco.MjModel,
    where: str,
    notes: list[str],
) -> JointScale:
    sign, owner = int(table.get("sign", 1)), part_names(model, "joint")[joint]
    hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
    if (unit in ("deg", "rad") and not hinge) or (unit == "m" and hinge):
        kind, fits = ("hinge", "deg, rad") if hinge else ("slide", "m")
        raise InputError(
            f'{where}: the values of {name!r} are in {unit}, but the joint {owner!r} is a {kind}; write unit = "..." '
            f"({fits}, range or percent) below {heading(name)}"
        )
    if unit in FACTORS:
        if "range" in table:
            raise InputError(f"{where}: {heading(name)} range is of the units range and percent; of {unit}, write zero")
        if "zero" in table:
            return JointScale(name, owner, unit, sign, float(table["zero"]))
        return JointScale(name, owner, unit, sign, _zero(name, values, unit, sign, joint, model, notes))
    if "zero" in table:
        raise InputError(f"{where}: {heading(name)} zero is of the units deg, rad and m; of {unit}, write range")
    if "range" in table:
        return JointScale(name, owner, unit, sign, ends=(float(table["range"][0]), float(table["range"][1])))
    if not model.jnt_limited[joint]:
        raise InputError(
            f"{where}: the values of {name!r} are shares of a range, but the joint {owner!r} of the model has none; "
            f"write range = [LOW, HIGH] (positions at the ends) below {heading(name)}"
        )
    low, high = map(float, model.jnt_range[joint])
    first, last = SPANS[unit]
    why = "its range in the model"
    # A gripper's scale matters less than that it keeps its limits.
    if unit == "range" and step is not None and hinge and _SHARES[0] / 2 < step < _SHARES[1]:
        width = (last - first) / step * 2 * np.pi / COUNTS
        middle = 0.0 if width > 2 * np.pi - 0.01 else (low + high) / 2  # a joint that turns freely has no middle
        counted = f"{width:.4g} rad by {(last - first) / step:.0f} counts of the encoder"
        why = f"{counted}; in the model {low:.4g} to {high:.4g}"
        low, high = middle - width / 2, middle + width / 2
    notes.append(f"{name}: {first:.0f} to {last:.0f} is {low:.4g} to {high:.4g} {'rad' if hinge else 'm'} ({why})")
    return JointScale(name, owner, unit, sign, ends=(low, high))


def _zero(
    name: str, values: np.ndarray, unit: str, sign: int, joint: int, model: mujoco.MjModel, notes: list[str]
) -> float:
    """The value at which the model's joint is at 0: 0, or the middle of the joint's range is at 0."""
    fitting = _fitting(values, unit, joint, model, sign)
    low, high = model.jnt_range[joint]
    if fitting is None:
        reach = " to ".join(f"{x:.4g}" for x in (values.min(), values.max()))
        ends = " to ".join(f"{x / FACTORS[unit]:.4g}" for x in (low, high))
        notes.append(
            f"assumed: zero of {name} is that of the model's joint, but its values ({reach}) leave the range of the "
            f"model ({ends} {unit}): its calibration is another one; write zero = VALUE AT WHICH THE MODEL'S JOINT IS "
            f"AT 0, and sign = -1 if it counts the other way round, below {heading(name)}"
        )
        return 0.0
    if fitting:
        notes.append(
            f"zero of {name} is in the middle of its range in the model, where LeRobot's calibration has it; with that "
            f"of the model its values would leave the range"
        )
    return fitting


def _fitting(values: np.ndarray, unit: str, joint: int, model: mujoco.MjModel, sign: int = 1) -> float | None:
    """The first zero, of those that are usual, with which values stay inside a joint's limits; None if none does."""
    if not model.jnt_limited[joint]:
        return 0.0
    low, high = map(float, model.jnt_range[joint])
    middle = -sign * (low + high) / 2 / FACTORS[unit]
    for zero in (0.0, middle):
        position = sign * FACTORS[unit] * (values - zero)
        if _between(position, low - _SLACK, high + _SLACK):
            return zero
    return None


def _between(values: np.ndarray, low: float, high: float) -> bool:
    return bool(np.mean((values >= low) & (values <= high)) >= _INSIDE)
