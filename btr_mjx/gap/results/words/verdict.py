"""The verdict of a diagnosis in at most two sentences, and what else there is to say, one sentence a line.

Every function returns text and computes nothing else. Both are part of result.json and of the page.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results.words.changes import SAME_REST, UNCHANGED, change_in_words
from btr_mjx.gap.results.words.terms import (
    REASON_NOT_NAMED,
    as_float,
    effect_at_place,
    error_in_words,
    format_number,
    parameters_in_words,
    place_in_words,
)

TIMES_NOISE = 3.0
"""A held-out gap beyond which the rest is not noise, in units of what simulated nulls leave."""

_LITTLE = 1.3
"""The same beyond which more than noise is left."""

_ABSENT = 0.05
"""Number of a joint, as a share of that of the joint that is named, below which nothing was found there."""

_LISTED = 3
"""Effects and candidates that a sentence lists, at most; the others are counted."""

_UNUSED = "recordings that were not used"


def verdict_sentence(result: Mapping[str, Any]) -> str:
    """The outcome of a diagnosis in one sentence or two.

    Args:
      result: content of result.json.

    Returns:
      What is missing where, how large it is, and how much of the disagreement on held-out data it explains.
    """
    verdict, effects = result.get("verdict"), list(result.get("effects") or [])
    if result.get("before"):
        return _change_sentence(result, effects)
    if verdict == "effect" and effects:
        return f"{_named(result, effects)}{_no_use(result)} {_explained(result)}".strip()
    if verdict == "none":
        nothing = "Nothing need be missing" if result.get("equivalent") else "Nothing is missing"
        others = _alternatives(_others(result))
        more = f" {_capital(others)} is not ruled out." if others else ""
        return f"{nothing}: simulation and data agree within the noise and the usual tolerances.{more}"
    return f"Something is missing that none of the known effects explains{_looks(result)}"


def _looks(result: Mapping[str, Any]) -> str:
    """Where what is unexplained is, and what it looks like."""
    where = f", most of it at {result['where']}" if result.get("where") else ""
    looks = result.get("unexplained") or []
    return f"{where}." + (f" It looks like this: {looks[0].rstrip('.')}." if looks else "")


def _change_sentence(result: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> str:
    """What has changed since the recordings before."""
    if result.get("verdict") == "effect" and effects:
        said = change_in_words(effects, _LISTED)
        return f"{said}{_no_use(result)} {_explained(result)}".strip()
    if result.get("verdict") == "none":
        return SAME_REST if _leaves_much(result) else UNCHANGED
    if result["before"].get("verdict") == "unexplained":
        return f"What has changed cannot be told: no known effect explains the recordings before either{_looks(result)}"
    return f"Something has changed that none of the known effects explains{_looks(result)}"


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
        f"Before: {result['before']['sentence']}" if result.get("before") else "",
        _whole_recordings(result) if verdict == "effect" else "",
        "" if result.get("before") else _calibration(result),
        _runner_up(result) if verdict == "effect" else "",
        _best_candidate(result) if verdict == "unexplained" else "",
        _equivalent(result),
    ]
    return [line for line in lines if line]


def _named(result: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> str:
    each = []
    for effect in effects[:_LISTED]:  # the numbers say that each member has its own
        place = {**effect, "location": str(effect["location"]).removeprefix(EACH_MEMBER)}
        joint = effect.get("joint") or ""
        drives = f" of joint {joint}" if joint and not place["location"].endswith(f":{joint}") else ""
        each.append(f"{effect_at_place(place)}{drives} ({parameters_in_words(effect)})")
    if len(effects) > _LISTED:
        more = len(effects) - _LISTED
        each.append(f"{more} more effect{'s' if more > 1 else ''}, listed in the table")
    if _leaves_much(result):
        return f"A part of what is missing is {' and '.join(each)}"
    return f"The missing effect{'s are' if len(effects) > 1 else ' is'} {' and '.join(each)}"


def _no_use(result: Mapping[str, Any]) -> str:
    """The end of the first sentence: whether the mended model predicts no better than two simple predictors."""
    of = result.get("predictions") or {}
    believed, mended, steady = (as_float(of.get(key)) for key in ("believed", "mended", "constant_velocity"))
    if believed is None or mended is None or steady is None or mended < min(believed, steady):
        return "."
    rival = _first_model(result) if believed <= steady else "constant velocity"
    return f", but {rival} predicts held-out recordings no worse: do not predict with the mended model."


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
        f"with {_first_model(result)}{own}, with constant velocity by {steady} (root mean square of all joints)."
    )


def _is_mixed(result: Mapping[str, Any]) -> bool:
    """Whether a mean over all joints would add radians and metres, where errors by joint are there to be told."""
    return "and" in str((result.get("gap") or {}).get("open_loop_unit")) and bool(result.get("joint_errors"))


def _first_model(result: Mapping[str, Any]) -> str:
    """The model that effects are beside."""
    return "the model from before" if result.get("before") else "the believed model"


def _calibration(result: Mapping[str, Any]) -> str:
    """What the mended model has beside what was named."""
    found = list(result.get("calibration") or [])
    if not found:
        return ""
    each = [f"{effect_at_place(row)} ({parameters_in_words(row)})" for row in found[:_LISTED]]
    more = f" and {len(found) - _LISTED} more, listed in result.json" if len(found) > _LISTED else ""
    return f"The mended model is calibrated within the usual tolerances: {', '.join(each)}{more}."


def _levels(result: Mapping[str, Any]) -> tuple[float | None, float | None, float | None]:
    """The held-out gap before and after, and what noise leaves."""
    gap = result.get("gap") or {}
    before, after, nulls, floor = (as_float(gap.get(key)) for key in ("before", "after", "nulls", "noise_floor"))
    return before, after, nulls if nulls else floor


def _leaves_much(result: Mapping[str, Any]) -> bool:
    _, after, noise = _levels(result)
    return after is not None and bool(noise) and after > TIMES_NOISE * noise  # type: ignore[operator]


def _explained(result: Mapping[str, Any]) -> str:
    """How much of the disagreement on held-out data the named effects explain, and what the rest is."""
    before, after, noise = _levels(result)
    if before is None or after is None:
        return ""
    many = len(result.get("effects") or []) > 1
    it, explains = ("They", "explain") if many else ("It", "explains")
    unit = str((result.get("gap") or {}).get("unit") or "")
    if after >= before:
        return f"On {_UNUSED} the gap does not fall with {'them' if many else 'it'}: do not rely on this name."
    if "Delta_fitness" in unit:
        return f"{it} {explains} {_percent(1 - after / before)} of Delta_fitness on trials that were not used."
    if not noise:
        return f"{it} {explains} {_percent(1 - after / before)} of the disagreement on {_UNUSED}."
    if before <= _LITTLE * noise:
        return f"On {_UNUSED} the disagreement is close to the noise with and without {'them' if many else 'it'}."
    share = (before - after) / (before - min(noise, after))
    is_all = after <= _LITTLE * noise
    rest = "the rest is noise" if is_all else "more than noise is left"
    return f"{it} {explains} {_percent(share, is_all)} of the disagreement on {_UNUSED}{_joint(result)}; {rest}."


def _joint(result: Mapping[str, Any]) -> str:
    """Errors of the named joint, else of the one that is worst beside its noise, before and after."""
    rows = result.get("joint_errors") or []
    if not rows:
        return ""
    named = {place_in_words(str(effect["location"])) for effect in result.get("effects") or []}
    own = [row for row in rows if row["joint"] in named] or rows
    row = max(own, key=lambda row: row["before"] / max(row["noise"], 1e-300))
    before, after, noise = (error_in_words(row[key], row["unit"]) for key in ("before", "after", "noise"))
    ahead = f"predicted over {row['horizon']:g} s, {row['joint']} is off by {after} instead of {before}"
    return f": {ahead}, where noise makes {noise}"


def _percent(share: float, is_all: bool = False) -> str:
    """A share in per cent; what is not all is not rounded to all."""
    value = 100 * min(share, 1.0)
    if value > 99.5 and not is_all:
        return "more than 99 %"
    return f"{value:.0f} %" if value >= 1 else f"{format_number(value, 1)} %"


def _gap(result: Mapping[str, Any]) -> str:
    before, after, noise = _levels(result)
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


def _runner_up(result: Mapping[str, Any]) -> str:
    same = {_key(effect) for effect in result.get("effects") or []}
    rows = [row for row in result.get("ranking") or [] if not row.get("beside")]
    ranked = [row for row in rows if _key(row) in same]
    together = {row.get("score") for row in ranked}  # what was tried in one hypothesis has one score
    others = [
        row for row in rows if _key(row) not in same and not row.get("equivalent") and row.get("score") not in together
    ]
    if not others:
        return ""
    best, second = (as_float(ranked[0].get("score")) if ranked else None), as_float(others[0].get("score"))
    if best is None or second is None or best <= 0:
        return f"Runner-up: {effect_at_place(others[0])}."
    share = second / best
    how = "far behind" if share < 0.6 else "behind" if share < 0.9 else "close behind"
    first = (
        "The next best that is not equivalent"
        if any(row.get("equivalent") for row in rows if _key(row) not in same)
        else "Runner-up"
    )
    return f"{first}: {effect_at_place(others[0])}, {how} ({100 * max(share, 0):.0f} % of the score)."


def _best_candidate(result: Mapping[str, Any]) -> str:
    """The candidate that comes nearest where nothing is named."""
    rows = [row for row in result.get("ranking") or [] if not row.get("beside")]
    score, share = (as_float(rows[0].get("score")) if rows else None), as_float(result.get("share"))
    if score is None or score <= 0:
        return ""
    part = f" explains {_percent(share)} of the unknown force and" if share is not None and share > 0 else ""
    return f"The best candidate, {effect_at_place(rows[0])},{part} leaves too much to be named."


def _key(row: Mapping[str, Any]) -> tuple[str, str]:
    return str(row["effect"]), str(row["location"])


def _others(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Candidates that these data cannot distinguish from what is named."""
    same = {_key(effect) for effect in result.get("effects") or []}
    return [entry for entry in result.get("equivalent") or [] if _key(entry) not in same]


def _alternatives(others: Sequence[Mapping[str, Any]]) -> str:
    more = f" (and {len(others) - _LISTED} more)" if len(others) > _LISTED else ""
    return " or ".join(effect_at_place(m) for m in others[:_LISTED]) + more


def _absent_members(result: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """What a candidate with a number for every joint finds beside the named joint, where that is next to nothing."""
    effects = result.get("effects") or []
    if len(effects) != 1 or effects[0]["effect"] != other["effect"] or not other["location"].startswith(EACH_MEMBER):
        return ""
    named = str(effects[0]["location"]).partition(":")[2]
    rows = [row for row in result.get("ranking") or [] if _key(row) == _key(other) and not row.get("beside")]
    found = {name: as_float(value) for name, value in (rows[0].get("parameters") or {}).items()} if rows else {}
    own = [value for name, value in found.items() if name.endswith(f"[{named}]")]
    rest = {name: value for name, value in found.items() if not name.endswith(f"[{named}]")}
    if not own or own[0] is None or not rest:
        return ""
    if not all(value is not None and abs(value) < _ABSENT * abs(own[0]) for value in rest.values()):
        return ""
    return ", ".join(f"{name} = {format_number(value, 2)}" for name, value in list(rest.items())[:_LISTED])


def _equivalent(result: Mapping[str, Any]) -> str:
    """Candidates that these data cannot distinguish, and a pointer to the next experiment."""
    others = _others(result)
    if not others:
        return ""
    then = ": run the experiment below next." if result.get("next_experiment") else "."
    if result.get("verdict") == "none":
        return f"{_capital(_alternatives(others))} explains more than chance, but {REASON_NOT_NAMED}{then}"
    nothing = {id(other): _absent_members(result, other) for other in others}
    lines = [
        f"{_capital(effect_at_place(other))}, contains it; none was found at the other ones ({nothing[id(other)]}): "
        "take the simpler one."
        for other in others
        if nothing[id(other)]
    ]
    rivals = [other for other in others if not nothing[id(other)]]
    if rivals:
        if not result.get("next_experiment"):
            then = ", and none of the commands that were tried separates them: take the simpler one."
        lines.append(f"These data cannot tell it apart from {_alternatives(rivals)}{then}")
    return " ".join(lines)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
