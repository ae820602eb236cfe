"""Words for numbers with their intervals and units, as sentences, tables and figures have them.

Every function returns text and computes nothing else. `verdict` builds the sentences of a verdict of them.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results.words.effects import member_of, words_of

_FEW = 3
"""So many numbers of the members of a group are written out in a sentence, at most."""

REASON_NOT_NAMED = "small errors of calibration explain nearly as much, or held-out recordings do not bear it out"
"""Reason why a candidate is neither named nor ruled out."""


def refit_sentence(name: str, before: float, after: float) -> str:
    """A sentence on a believed parameter whose refitted value changed when an effect was added.

    Args:
      name: name of the parameter.
      before: refitted value without the effect.
      after: refitted value with the effect.

    Returns:
      The sentence.
    """
    change = f"from {format_number(before)} to {format_number(after)}"
    return f"The believed {name} moved {change} when the effect entered."


def format_number(value: float | None, digits: int = 3) -> str:
    """A number as text.

    Args:
      value: the number; None, NaN and infinities become a dash.
      digits: significant digits.

    Returns:
      Fixed-point text between 1e-4 and 1e6, otherwise a mantissa and a power of ten.
    """
    if value is None or not math.isfinite(float(value)):
        return "–"
    value = float(value)
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if -4 <= size < 6:
        text = f"{value:.{max(digits - 1 - size, 0)}f}"
        return (text.rstrip("0").rstrip(".") if "." in text else text).replace("-", "−")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa}·10^{int(exponent)}".replace("-", "−")


def score_in_words(score: Any, best: float) -> str:
    """A score in per cent of the best one's; a dash where either is not known."""
    value = as_float(score)
    return "–" if value is None or not best > 0 else format_number(100 * value / best)


def in_reading_unit(value: Any, unit: str) -> tuple[Any, str]:
    """A position error, or an array of them, in degrees or millimetres, with the unit; others as they are."""
    if unit == "rad":
        return np.degrees(value), "°"
    return (1000 * value, "mm") if unit == "m" else (value, unit)


def error_in_words(value: float, unit: str) -> str:
    """A position error such as "1.2°" or "3.4 mm"."""
    shown, unit = in_reading_unit(value, unit)
    return f"{format_number(float(shown))}{'' if unit == '°' else ' '}{unit}"


def format_estimate(parameter: Mapping[str, Any]) -> str:
    """An estimate with its interval and unit.

    Args:
      parameter: an entry of `parameters` in result.json: value, low, high, unit, edge.

    Returns:
      "0.31 ± 0.03 N m" where the interval is nearly symmetric, otherwise value and both ends: "2 [1, 4] kg".
    """
    value, low, high = (as_float(parameter.get(key)) for key in ("value", "low", "high"))
    unit = _unit_words(parameter)
    if value is None:
        return "–"
    if parameter.get("edge"):
        return f"{format_number(value)}{unit} (the edge of what is tried; the true one may be beyond)"
    if low is None or high is None:
        return f"{format_number(value)}{unit}"
    above, below = high - value, value - low
    if not (above or below):
        return f"{format_number(value)}{unit}"
    if above >= 0 and below >= 0 and abs(above - below) <= 0.35 * max(above, below):
        return f"{_rounded(value, (above + below) / 2)}{unit}"
    return f"{format_number(value)} [{format_number(low)}, {format_number(high)}]{unit}"


def _rounded(value: float, error: float) -> str:
    """Value and error, rounded to two digits of the error."""
    if not error > 0:
        return format_number(value)
    decimals = _decimals(error)
    if decimals > 8 or abs(value) >= 1e6:
        return f"{format_number(value)} ± {format_number(error, 2)}"
    return f"{value:.{decimals}f} ± {error:.{decimals}f}".replace("-", "−")


def _decimals(error: float) -> int:
    """Decimals that show two digits of an error."""
    return max(0, 1 - math.floor(math.log10(error)))


def estimate_cells(parameter: Mapping[str, Any]) -> dict[str, str]:
    """Value, low and high of a parameter as text, with enough digits to distinguish them.

    Args:
      parameter: an entry of `parameters` in result.json.

    Returns:
      Text for the keys value, low and high.
    """
    found = {key: as_float(parameter.get(key)) for key in ("value", "low", "high")}
    known = [v for v in found.values() if v is not None]
    apart = [abs(v - known[0]) for v in known[1:] if v != known[0]]
    if len(known) < len(found) or not apart or max(map(abs, known)) >= 1e6 or _decimals(min(apart)) > 8:
        return {key: format_number(value) for key, value in found.items()}
    decimals = _decimals(min(apart))
    return {key: f"{value:.{decimals}f}".replace("-", "−") for key, value in found.items()}


def as_float(value: Any) -> float | None:
    """A finite number of result.json; None for anything else."""
    try:
        out = float(value)
    except (TypeError, ValueError):
        return None
    return out if math.isfinite(out) else None


def parameters_in_words(effect: Mapping[str, Any]) -> str:
    """All parameters of an effect in result.json, with intervals; the range of many numbers of one kind."""
    parameters = effect["parameters"]
    if effect.get("latex"):  # a law: its numbers are in its equation
        return str(effect["equation"])
    if effect["effect"] == "load_friction" and set(parameters) == {"coefficient"}:
        return f"{format_estimate(parameters['coefficient'])} of the motor torque"
    if str(effect["location"]).startswith(EACH_MEMBER) and len(parameters) > _FEW:
        rows = {member_of(name): in_percent(name, p) for name, p in parameters.items()}
        values = {member: as_float(p["value"]) or 0.0 for (_, member), p in rows.items()}
        ends = [format_number(f(values.values())) for f in (min, max)]
        (kind, _), one = next(iter(rows.items()))
        largest = max(values, key=lambda member: abs(values[member]))
        return f"{kind} from {ends[0]} to {ends[1]}{_unit_words(one)}, the largest at {largest}"
    return ", ".join(
        f"{parameter_in_words(name)} {format_estimate(in_percent(name, p))}" for name, p in parameters.items()
    )


def size_in_words(effect: Mapping[str, Any]) -> str:
    """How large an effect is, such as "0.6 kg": its number where there is one or one counts, else all of them."""
    name, first = next(iter(effect["parameters"].items()))
    if len(effect["parameters"]) > 1 and not words_of(str(effect["effect"])).grows:
        return parameters_in_words(effect)
    return format_estimate(in_percent(name, first))


def parameter_in_words(name: str) -> str:
    """A parameter's name in words, such as "armature at knee" for "armature[knee]"."""
    kind, member = member_of(name)
    return f"{kind} at {member}" if member else kind


def in_percent(name: str, parameter: Mapping[str, Any]) -> dict[str, Any]:
    """An estimate with its numbers in per cent where it is a relative change.

    Args:
      name: of the parameter.
      parameter: an entry of `parameters` in result.json.
    """
    if not name.startswith("change") or parameter.get("unit") != "1":
        return dict(parameter)
    found = {key: as_float(parameter.get(key)) for key in ("value", "low", "high")}
    return dict(parameter) | {key: None if v is None else 100 * v for key, v in found.items()} | {"unit": "%"}


def _unit_words(parameter: Mapping[str, Any]) -> str:
    unit = unit_in_words(parameter.get("unit"))
    return f" {unit}" if unit else ""


def unit_in_words(unit: Any) -> str:
    """A unit as people write it, such as "kg m²" for "kg m^2"; "" for numbers without one."""
    text = str(unit or "")
    return "" if text == "1" else text.replace("^2", "²").replace("^3", "³")
