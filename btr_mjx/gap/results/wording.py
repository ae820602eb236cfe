"""The results of a diagnosis in sentences: the verdict, effects, places, and numbers with their intervals.

Every function returns text and computes nothing else. The sentences are part of result.json and of the page.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER

EFFECT_TITLES: Mapping[str, str] = {
    "viscous_damping": "viscous damping",
    "dry_friction": "dry friction",
    "load_friction": "load-dependent gear friction",
    "stribeck_friction": "Stribeck (breakaway) friction",
    "armature": "rotor inertia (armature)",
    "joint_stiffness": "a spring",
    "joint_offset": "an encoder offset",
    "backlash": "backlash",
    "actuator_delay": "a delay of the command",
    "actuator_lag": "a first-order lag of the command",
    "command_rate_limit": "a limit of the command's rate",
    "actuator_gain": "a change of the motor's strength",
    "torque_limit": "a torque limit",
    "payload": "a payload",
    "link_length": "another length of the link",
    "com_shift": "a shift of the centre of mass",
    "constant_force": "a constant force",
    "air_drag": "air drag",
    "ground_slope": "a slope of the ground",
    "ground_friction": "another friction of the ground",
    "contact_softness": "another softness of contact",
    "hardening_spring": "a hardening spring",
    "one_sided_spring": "a spring on one side",
    "fading_motor": "a motor that loses force over time",
    "elastic_cord": "an elastic cord",
}
"""Effects of the library as they appear in sentences; other effects appear by their names."""

_MORE: Mapping[str, tuple[str, str]] = {
    "viscous_damping": ("more viscous damping", "less viscous damping"),
    "dry_friction": ("more dry friction", "less dry friction"),
    "armature": ("more rotor inertia", "less rotor inertia"),
    "actuator_delay": ("a later command", "an earlier command"),
    "actuator_gain": ("a stronger motor", "a weaker motor"),
    "payload": ("more mass", "less mass"),
    "link_length": ("a longer link", "a shorter link"),
    "ground_friction": ("more friction of the ground", "less friction of the ground"),
    "contact_softness": ("softer contacts", "harder contacts"),
    "air_drag": ("more air drag", "less air drag"),
}
"""Effects whose first parameter may rise or fall: words for an increase and for a decrease."""

TIMES_NOISE = 3.0
"""A held-out gap beyond which the verdict says how much is left, in units of what simulated nulls leave."""

_FEW = 6
"""So many numbers of the members of a group are written out in a sentence, at most."""

REASON_NOT_NAMED = "small errors of calibration explain nearly as much, or held-out recordings do not bear it out"
"""Reason why a candidate is neither named nor ruled out."""


def effect_title(effect: str) -> str:
    """An effect in words, such as "viscous damping"."""
    return EFFECT_TITLES.get(effect, effect.replace("_", " "))


def place_in_words(label: str) -> str:
    """A place in words, such as "joint knee" for "joint:knee"."""
    if label.startswith(EACH_MEMBER):
        return f"{place_in_words(label.removeprefix(EACH_MEMBER))}, each with its own number"
    kind, _, name = label.partition(":")
    if kind == "subtree":
        return f"every joint from body {name} down"
    if not name:
        return {"all": "all joints", "world": "the world as a whole"}.get(label, label)
    return f"{kind} {name}"


def effect_at_place(row: Mapping[str, Any]) -> str:
    """Effect and place of an entry of results, in words."""
    return f"{effect_title(str(row['effect']))} at {place_in_words(str(row['location']))}"


def confound_sentence(effect: str, location: str, change: float, correlation: float) -> str:
    """A sentence on a change that would leave almost the same traces as a named effect.

    Args:
      effect: name of the other effect, or of a believed parameter.
      location: its place; "" for a believed parameter.
      change: change of its first parameter; only the sign counts.
      correlation: correlation of the two signatures, in [0, 1].

    Returns:
      The sentence.
    """
    if not location:
        what = f"a {'larger' if change > 0 else 'smaller'} {effect}"
    else:
        more, less = _MORE.get(effect, (effect_title(effect), effect_title(effect)))
        what = f"{more if change > 0 else less} at {place_in_words(location)}"
    how = "almost the same" if correlation >= 0.95 else "similar"
    return f"{what[0].upper()}{what[1:]} would leave {how} traces ({correlation:.2f})."


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


def format_estimate(parameter: Mapping[str, Any]) -> str:
    """An estimate with its interval and unit.

    Args:
      parameter: an entry of `parameters` in result.json: value, low, high, unit, edge.

    Returns:
      "0.31 ± 0.03 N m" where the interval is nearly symmetric, otherwise value and both ends: "2 [1, 4] kg".
    """
    value, low, high = (_float(parameter.get(key)) for key in ("value", "low", "high"))
    unit = str(parameter.get("unit", "") or "")
    unit = "" if unit in ("1", "") else f" {unit}"
    if value is None:
        return "–"
    if parameter.get("edge"):
        return f"{format_number(value)}{unit} (the edge of what is tried; the true one may be beyond)"
    if low is None or high is None:
        return f"{format_number(value)}{unit}"
    above, below = high - value, value - low
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
    found = {key: _float(parameter.get(key)) for key in ("value", "low", "high")}
    known = [v for v in found.values() if v is not None]
    apart = [abs(v - known[0]) for v in known[1:] if v != known[0]]
    if len(known) < len(found) or not apart or max(map(abs, known)) >= 1e6 or _decimals(min(apart)) > 8:
        return {key: format_number(value) for key, value in found.items()}
    decimals = _decimals(min(apart))
    return {key: f"{value:.{decimals}f}".replace("-", "−") for key, value in found.items()}


def _float(value: Any) -> float | None:
    try:
        out = float(value)
    except (TypeError, ValueError):
        return None
    return out if math.isfinite(out) else None


def parameters_in_words(effect: Mapping[str, Any]) -> str:
    """All parameters of an effect in result.json, with intervals; the range of many numbers of one kind."""
    if effect["effect"] == "load_friction" and set(effect["parameters"]) == {"coefficient"}:
        return f"{format_estimate(effect['parameters']['coefficient'])} of the motor torque"
    parameters = effect["parameters"]
    if str(effect["location"]).startswith(EACH_MEMBER) and len(parameters) > _FEW:
        ends = [format_number(f([_float(p["value"]) or 0.0 for p in parameters.values()])) for f in (min, max)]
        name, first = next(iter(parameters.items()))
        return f"{name.partition('[')[0].replace('_', ' ')} {ends[0]} to {ends[1]} {first.get('unit', '')}".strip()
    return ", ".join(f"{name.replace('_', ' ')} {format_estimate(p)}" for name, p in parameters.items())


def verdict_sentence(result: Mapping[str, Any]) -> str:
    """The outcome of a diagnosis in one paragraph.

    Args:
      result: content of result.json.

    Returns:
      Where simulation and data disagree, the verdict, the held-out gap, and what is equivalent.
    """
    parts = [_where(result)]
    verdict, effects = result.get("verdict"), list(result.get("effects") or [])
    if verdict == "effect" and effects:
        subject = "The missing effect is" if len(effects) == 1 else "The missing effects are"
        each = " and ".join(f"{effect_at_place(effect)} ({parameters_in_words(effect)})" for effect in effects)
        parts.append(f"{subject} {each}.")
        parts.append(_gap(result))
        parts.append(_left_over(result))
        parts.append(_runner_up(result))
    elif verdict == "none":
        nothing = "Nothing need be missing" if result.get("equivalent") else "Nothing is missing"
        parts = [f"{nothing}: simulation and data agree within the noise and the usual tolerances."]
        parts.append(_noise_floor(result))
    else:
        parts.append("Something is missing that none of the known effects explains.")
        looks = _description(result)
        parts.append(f"It looks like this: {looks}" if looks else "")
        parts.append(_noise_floor(result))
    parts.append(_equivalent(result))
    return " ".join(part for part in parts if part)


def _where(result: Mapping[str, Any]) -> str:
    where = result.get("where")
    return f"Simulation and data disagree most at {where}." if isinstance(where, str) and where else ""


def _gap(result: Mapping[str, Any]) -> str:
    gap = result.get("gap") or {}
    before, after, floor = (_float(gap.get(key)) for key in ("before", "after", "noise_floor"))
    if before is None or after is None:
        return ""
    many = "them" if len(result.get("effects") or []) > 1 else "it"
    inside = [f"noise floor {format_number(floor)}"] if floor is not None else []
    inside += [str(gap["unit"])] if gap.get("unit") else []
    fall = f"from {format_number(before)} to {format_number(after)}" + (f" ({'; '.join(inside)})" if inside else "")
    start, end = _float(gap.get("open_loop_before")), _float(gap.get("open_loop_after"))
    if start is None or end is None:
        return f"Adding {many} shrinks the held-out gap {fall}."
    unit = gap.get("open_loop_unit", "rad")
    whole = "the position error over whole held-out recordings, simulated from their first sample,"
    if end < start:
        path = f"from {format_number(start)} to {format_number(end)} {unit}"
        return f"Adding {many} shrinks {whole} {path}, and the gap over short stretches {fall}."
    without, added = (f"{format_number(error)} {unit}" for error in (start, end))
    return (
        f"Adding {many} shrinks the gap over short held-out stretches {fall}, but not {whole} which is {without} "
        f"without and {added} with {many}: where small differences grow, a motion can be followed over short "
        "stretches only."
    )


def _left_over(result: Mapping[str, Any]) -> str:
    """What the named effects leave, where it is far more than noise."""
    gap = result.get("gap") or {}
    closed, after, nulls = (_float(gap.get(key)) for key in ("closed", "after", "nulls"))
    if closed is None or after is None or not nulls or after < TIMES_NOISE * nulls:
        return ""
    return (
        f"This explains {100 * closed:.0f} % of the held-out gap; {format_number(after / nulls)} times the noise is "
        "left, so that something else is missing as well."
    )


def _noise_floor(result: Mapping[str, Any]) -> str:
    gap = result.get("gap") or {}
    before, floor = _float(gap.get("before")), _float(gap.get("noise_floor"))
    if before is None:
        return ""
    unit = f" ({gap['unit']})" if gap.get("unit") else ""
    return f"The held-out gap is {format_number(before)}{unit}" + (
        f", the noise floor {format_number(floor)}." if floor else "."
    )


def _runner_up(result: Mapping[str, Any]) -> str:
    same = {_key(effect) for effect in result.get("effects") or []}
    rows = [row for row in result.get("ranking") or [] if not row.get("beside")]
    others = [row for row in rows if _key(row) not in same and not row.get("equivalent")]
    ranked = [row for row in rows if _key(row) in same]
    if not others:
        return ""
    best, second = (_float(ranked[0].get("score")) if ranked else None), _float(others[0].get("score"))
    if best is None or second is None or best <= 0:
        return f"Runner-up: {effect_at_place(others[0])}."
    share = second / best
    how = "far behind" if share < 0.6 else "behind" if share < 0.9 else "close behind"
    return f"Runner-up: {effect_at_place(others[0])}, {how} ({100 * max(share, 0):.0f} % of the score)."


def _key(row: Mapping[str, Any]) -> tuple[str, str]:
    return str(row["effect"]), str(row["location"])


def _equivalent(result: Mapping[str, Any]) -> str:
    """Candidates that these data cannot distinguish, and a pointer to the next experiment."""
    same = {_key(effect) for effect in result.get("effects") or []}
    others = []
    for entry in result.get("equivalent") or []:
        members = entry if isinstance(entry, Sequence) and not isinstance(entry, str | Mapping) else [entry]
        others += [m for m in members if isinstance(m, Mapping) and "effect" in m and _key(m) not in same]
    if not others:
        return ""
    which = " or ".join(effect_at_place(m) for m in others[:4]) + (
        f" (and {len(others) - 4} more)" if len(others) > 4 else ""
    )
    text = f"These data cannot tell it apart from {which}"
    if result.get("verdict") == "none":
        text = f"Nor is {which} ruled out, but {REASON_NOT_NAMED}"
    return text + (": run the experiment below next." if result.get("next_experiment") else ".")


def _description(result: Mapping[str, Any]) -> str:
    looks = result.get("unexplained")
    if isinstance(looks, Mapping):
        looks = looks.get("description") or looks.get("text")
    if isinstance(looks, Sequence) and not isinstance(looks, str):
        looks = "; ".join(str(item.get("text", item)) if isinstance(item, Mapping) else str(item) for item in looks)
    text = str(looks or "").strip()
    return text if not text or text.endswith(".") else f"{text}."
