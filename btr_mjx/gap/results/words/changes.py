"""The change from one set of recordings to the next in words: what has grown, fallen or moved, and by how much.

Every function returns text and computes nothing else.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results.words.terms import (
    as_float,
    effect_at_place,
    effect_title,
    format_estimate,
    in_percent,
    parameters_in_words,
    place_in_words,
)

_GROWS: Mapping[str, str] = {
    "viscous_damping": "viscous damping",
    "dry_friction": "dry friction",
    "load_friction": "load-dependent gear friction",
    "armature": "rotor inertia",
    "actuator_delay": "the delay of the command",
    "actuator_lag": "the lag of the command",
    "actuator_gain": "the motor's strength",
    "servo_stiffness": "the servo's stiffness",
    "payload": "mass",
    "link_length": "the length of the link",
    "backlash": "backlash",
    "joint_stiffness": "the stiffness of a spring",
    "ground_friction": "friction of the ground",
}
"""Effects whose first parameter grows or falls."""

_MOVES: Mapping[str, str] = {
    "joint_offset": "the encoder's zero",
    "offset_torque": "a constant force",
    "com_shift": "the centre of mass",
}
"""Effects whose parameters have a sign."""

UNCHANGED = "Nothing has changed: one model explains both sets of recordings within the noise."
"""The sentence where no change was found."""

SAME_REST = "Nothing has changed that can be told: what the model lacks is alike in both sets of recordings."
"""The same where both sets hold more than the model explains."""


def change_in_words(effects: Sequence[Mapping[str, Any]], listed: int) -> str:
    """What has changed, as the beginning of a sentence.

    Args:
      effects: entries of `effects` in result.json, as changes since the recordings before.
      listed: effects that are said, at most; the others are counted.
    """
    each = [part for effect in effects[:listed] for part in _change(effect)]
    if len(effects) > listed:
        each.append(f"{len(effects) - listed} more, listed in the table, as well")
    text = " and ".join(each)
    return f"{text[:1].upper()}{text[1:]} since; nothing else has changed"


def _change(effect: Mapping[str, Any]) -> list[str]:
    """One effect, or each member of a group whose number has changed."""
    name, location = str(effect["effect"]), str(effect["location"])
    parameters = dict(effect["parameters"])
    if location.startswith(EACH_MEMBER):
        kind = "actuator" if name.startswith("actuator") else "joint"
        moved = {key: p for key, p in parameters.items() if not _may_be_nothing(p)} or parameters
        members = [(f"{kind}:{key.partition('[')[2].removesuffix(']')}", key, p) for key, p in moved.items()]
        return [_of_number(name, place, key, p, "") for place, key, p in members]
    first = next(iter(parameters))
    rest = {key: p for key, p in parameters.items() if key != first}
    if name in _GROWS and name not in _MOVES and not parameters[first].get("null"):
        more = f" ({parameters_in_words({**effect, 'parameters': rest})})" if rest else ""
        return [_of_number(name, location, first, parameters[first], more)]
    if name in _MOVES:
        return [f"{_MOVES[name]} at {place_in_words(location)} has moved by {parameters_in_words(effect)}"]
    return [f"{effect_at_place(effect)} has appeared ({parameters_in_words(effect)})"]


def _of_number(name: str, location: str, key: str, parameter: Mapping[str, Any], more: str) -> str:
    """A number that has grown or fallen."""
    shown = in_percent(key, parameter)
    value = as_float(shown.get("value")) or 0.0
    if name in _MOVES:
        return f"{_MOVES[name]} at {place_in_words(location)} has moved by {format_estimate(shown)}"
    if value < 0:
        ends = {"value": -value, "low": _minus(shown.get("high")), "high": _minus(shown.get("low"))}
        shown = shown | ends
    title = _GROWS.get(name, effect_title(name))
    verb = "grown" if value >= 0 else "fallen"
    return f"{title} at {place_in_words(location)} has {verb} by {format_estimate(shown)}{more}"


def _minus(value: Any) -> float | None:
    number = as_float(value)
    return None if number is None else -number


def _may_be_nothing(parameter: Mapping[str, Any]) -> bool:
    """Whether the interval of a number holds the value at which there is no effect."""
    low, high, null = (as_float(parameter.get(key)) for key in ("low", "high", "null"))
    return low is None or high is None or low <= (null or 0.0) <= high
