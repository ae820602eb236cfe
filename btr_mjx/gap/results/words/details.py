"""What else there is to say of a verdict, one sentence a line, as part of result.json and of the page.

Every function returns text and computes nothing else.
"""

from collections.abc import Mapping
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results.words.effects import effect_at_place
from btr_mjx.gap.results.words.terms import (
    REASON_NOT_NAMED,
    as_float,
    error_in_words,
    format_number,
    parameters_in_words,
)
from btr_mjx.gap.results.words.verdict import (
    MOST_LISTED,
    capitalised,
    effect_and_place,
    gap_levels,
    list_rivals,
    model_beside,
    rivals_of,
    share_in_words,
)

_ABSENT = 0.05
"""Number of a joint, as a share of that of the joint that is named, below which nothing was found there."""


def detail_sentences(result: Mapping[str, Any]) -> list[str]:
    """What else there is to say of a verdict, one sentence a line.

    Args:
      result: content of result.json.

    Returns:
      Where simulation and data disagree, the gap before and after, predictions beside two simple predictors, the next
      best candidate, and what is equivalent.
    """
    verdict = result.get("verdict")
    where = result.get("where") if verdict == "effect" else None
    lines = [
        f"Simulation and data disagree most at {where}." if where else "",
        _gap(result),
        _predictions(result),
        _time_step(result),
        f"Before: {result['before']['sentence']}" if result.get("before") else "",
        _whole_recordings(result) if verdict == "effect" else "",
        "" if result.get("before") else _calibration(result),
        _runner_up(result) if verdict == "effect" else "",
        _best_candidate(result) if verdict == "unexplained" else "",
        _equivalent(result),
    ]
    return [line for line in lines if line]


def _predictions(result: Mapping[str, Any]) -> str:
    """Errors of predictions over a short horizon."""
    of, unit = result.get("predictions") or {}, (result.get("gap") or {}).get("open_loop_unit", "rad")
    values = [as_float(of.get(key)) for key in ("believed", "mended", "constant_velocity")]
    if of.get("horizon") is None or None in values or _is_mixed(result):
        return ""
    believed, mended, steady = (error_in_words(value or 0.0, unit, 3) for value in values)
    is_mended = result.get("verdict") == "effect" or result.get("calibration")
    own = f", the mended one by {mended}" if is_mended else ""
    return (
        f"Predicted over {of['horizon']:g} s, positions of held-out recordings are off by {believed} "
        f"with {model_beside(result)}{own}, with constant velocity by {steady} (root mean square of all joints)."
    )


def _time_step(result: Mapping[str, Any]) -> str:
    """A time step of the search that is finer than the model's."""
    of = result.get("timestep") or {}
    own, finer = as_float(of.get("model")), as_float(of.get("search"))
    if own is None or finer is None or finer >= own:
        return ""
    return (
        f"The time step of the model, {1e3 * own:g} ms, is too coarse: the search and mended.xml have "
        f"{1e3 * finer:g} ms."
    )


def _is_mixed(result: Mapping[str, Any]) -> bool:
    """Whether a mean over all joints would add radians and metres, where errors by joint are there to be told."""
    return "and" in str((result.get("gap") or {}).get("open_loop_unit")) and bool(result.get("joint_errors"))


def _calibration(result: Mapping[str, Any]) -> str:
    """What the mended model has beside what was named."""
    found = list(result.get("calibration") or [])
    if not found:
        return ""
    each = [f"{effect_at_place(row)} ({parameters_in_words(row)})" for row in found[:MOST_LISTED]]
    more = f" and {len(found) - MOST_LISTED} more, listed in result.json" if len(found) > MOST_LISTED else ""
    return f"The mended model is calibrated within the usual tolerances: {', '.join(each)}{more}."


def _gap(result: Mapping[str, Any]) -> str:
    before, after, noise = gap_levels(result)
    is_mended = result.get("verdict") == "effect"
    if before is None or (after is None and is_mended):
        return ""
    words = f"is {format_number(before)}"
    if is_mended and after != before and after is not None:
        words = f"{'shrinks' if after < before else 'grows'} from {format_number(before)} to {format_number(after)}"
    unit = (result.get("gap") or {}).get("unit")
    leaves = f"; noise leaves {format_number(noise)}" if noise else ""
    return f"The held-out gap {words}{f' {unit}' if unit else ''}{leaves}."


def _whole_recordings(result: Mapping[str, Any]) -> str:
    """How well whole recordings are followed."""
    gap = result.get("gap") or {}
    start, end = as_float(gap.get("open_loop_before")), as_float(gap.get("open_loop_after"))
    if start is None or end is None or _is_mixed(result):
        return ""
    unit = gap.get("open_loop_unit", "rad")
    first, last = (error_in_words(value, unit, 3) for value in (start, end))
    whole = "over whole held-out recordings, simulated from their first sample"
    noise = as_float(gap.get("open_loop_noise"))
    leaves = f"; the sensors' noise alone makes {error_in_words(noise, unit, 3)}" if noise else ""
    if end < start:
        return f"The mean position error {whole}, falls from {first} to {last}{leaves}."
    return (
        f"The mean position error {whole}, is {first} without and {last} with it{leaves}: where small differences "
        "grow, a motion can be followed over short stretches only."
    )


def _alone(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Candidates of the ranking that were tried without others."""
    return [row for row in result.get("ranking") or [] if not row.get("beside")]


def _runner_up(result: Mapping[str, Any]) -> str:
    same = {effect_and_place(effect) for effect in result.get("effects") or []}
    named = [row for row in _alone(result) if effect_and_place(row) in same]
    rest = [row for row in _alone(result) if effect_and_place(row) not in same]
    # What was tried in one hypothesis has one score, and a name may be what is left of the best one.
    together = {row.get("score") for row in (*named, *_alone(result)[:1])}
    others = [row for row in rest if not row.get("equivalent") and row.get("score") not in together]
    if not others:
        return ""
    best, second = (as_float(named[0].get("score")) if named else None), as_float(others[0].get("score"))
    if best is None or second is None or best <= 0:
        return f"Runner-up: {effect_at_place(others[0])}."
    share = second / best
    how = "far behind" if share < 0.6 else "behind" if share < 0.9 else "close behind"
    first = "The next best that is not equivalent" if any(row.get("equivalent") for row in rest) else "Runner-up"
    return f"{first}: {effect_at_place(others[0])}, {how} ({100 * max(share, 0):.0f} % of the score)."


def _best_candidate(result: Mapping[str, Any]) -> str:
    """The candidate that comes nearest where nothing is named."""
    rows = _alone(result)
    score, share = (as_float(rows[0].get("score")) if rows else None), as_float(result.get("share"))
    if score is None or score <= 0:
        return ""
    part = f" explains {share_in_words(share)} of the unknown force and" if share is not None and share > 0 else ""
    return f"The best candidate, {effect_at_place(rows[0])},{part} leaves too much to be named."


def _absent_members(result: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """What a candidate with a number for every joint finds beside the named joint, where that is next to nothing."""
    effects = result.get("effects") or []
    if len(effects) != 1 or effects[0]["effect"] != other["effect"] or not other["location"].startswith(EACH_MEMBER):
        return ""
    named = str(effects[0]["location"]).partition(":")[2]
    rows = [row for row in _alone(result) if effect_and_place(row) == effect_and_place(other)]
    found = {name: as_float(value) for name, value in (rows[0].get("parameters") or {}).items()} if rows else {}
    own = [value for name, value in found.items() if name.endswith(f"[{named}]")]
    rest = {name: value for name, value in found.items() if not name.endswith(f"[{named}]")}
    if not own or own[0] is None or not rest:
        return ""
    if not all(value is not None and abs(value) < _ABSENT * abs(own[0]) for value in rest.values()):
        return ""
    return ", ".join(f"{name} = {format_number(value, 2)}" for name, value in list(rest.items())[:MOST_LISTED])


def _equivalent(result: Mapping[str, Any]) -> str:
    """Candidates that these data cannot distinguish, and a pointer to the next experiment."""
    others = rivals_of(result)
    if not others:
        return ""
    then = ": run the experiment below next." if result.get("next_experiment") else "."
    if result.get("verdict") == "none":
        return f"{capitalised(list_rivals(others))} explains more than chance, but {REASON_NOT_NAMED}{then}"
    nothing = {id(other): _absent_members(result, other) for other in others}
    lines = [
        f"{capitalised(effect_at_place(other))}, contains it; none was found at the other ones ({nothing[id(other)]}): "
        "take the simpler one."
        for other in others
        if nothing[id(other)]
    ]
    rivals = [other for other in others if not nothing[id(other)]]
    if rivals:
        if not result.get("next_experiment"):
            then = ", and none of the commands that were tried separates them: take the simpler one."
        lines.append(f"These data cannot tell it apart from {list_rivals(rivals)}{then}")
    return " ".join(lines)
