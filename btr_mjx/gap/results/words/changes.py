"""The change from one set of recordings to the next in words: what has grown, fallen or moved, and by how much.

Every function returns text and computes nothing else.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results.words.effects import effect_at_place, place_in_words, words_of
from btr_mjx.gap.results.words.terms import (
    as_float,
    format_estimate,
    in_percent,
    parameters_in_words,
)

UNCHANGED = "Nothing has changed: one model explains both sets of recordings within the noise."
"""The sentence where no change was found."""

SAME_REST = "Nothing has changed that can be told: what the model lacks is alike in both sets of recordings."
"""The same where both sets hold more than the model explains."""


def change_in_words(effects: Sequence[Mapping[str, Any]], listed: int) -> str:
    """Changes since the recordings before as the beginning of a sentence; what is not `listed` is counted."""
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
    (first, *_), own = parameters, words_of(name)
    rest = {key: p for key, p in parameters.items() if key != first}
    if own.grows and not parameters[first].get("null"):
        more = f" ({parameters_in_words({**effect, 'parameters': rest})})" if rest else ""
        return [_of_number(name, location, first, parameters[first], more)]
    if own.moves:
        return [f"{own.moves} at {place_in_words(location)} has moved by {parameters_in_words(effect)}"]
    return [f"{effect_at_place(effect)} has appeared ({parameters_in_words(effect)})"]


def _of_number(name: str, location: str, key: str, parameter: Mapping[str, Any], more: str) -> str:
    """A number that has grown or fallen."""
    shown = in_percent(key, parameter)
    value = as_float(shown.get("value")) or 0.0
    own = words_of(name)
    if own.moves:
        return f"{own.moves} at {place_in_words(location)} has moved by {format_estimate(shown)}"
    if value < 0:
        high, low = (None if (end := as_float(shown.get(key))) is None else -end for key in ("low", "high"))
        shown = shown | {"value": -value, "low": low, "high": high}
    verb = "grown" if value >= 0 else "fallen"
    return f"{own.grows or own.title} at {place_in_words(location)} has {verb} by {format_estimate(shown)}{more}"


def _may_be_nothing(parameter: Mapping[str, Any]) -> bool:
    """Whether the interval of a number holds the value at which there is no effect."""
    low, high, null = (as_float(parameter.get(key)) for key in ("low", "high", "null"))
    return low is None or high is None or low <= (null or 0.0) <= high
