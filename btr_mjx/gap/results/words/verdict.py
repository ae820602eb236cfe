"""The verdict of a diagnosis in at most two sentences, which are part of result.json and of the page.

Every function returns text and computes nothing else; `details` says the rest.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results.words.changes import SAME_REST, UNCHANGED, change_in_words
from btr_mjx.gap.results.words.effects import effect_at_place, place_in_words
from btr_mjx.gap.results.words.terms import (
    as_float,
    error_in_words,
    format_number,
    parameters_in_words,
)

TIMES_NOISE = 3.0
"""A held-out gap beyond which the rest is not noise, in units of what simulated nulls leave."""

_LITTLE = 1.3
"""The same beyond which more than noise is left."""

MOST_LISTED = 3
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
        others = list_rivals(rivals_of(result))
        more = f" {capitalised(others)} is not ruled out." if others else ""
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
        said = change_in_words(effects, MOST_LISTED)
        return f"{said}{_no_use(result)} {_explained(result)}".strip()
    if result.get("verdict") == "none":
        return SAME_REST if _leaves_much(result) else UNCHANGED
    if result["before"].get("verdict") == "unexplained":
        return f"What has changed cannot be told: no known effect explains the recordings before either{_looks(result)}"
    return f"Something has changed that none of the known effects explains{_looks(result)}"


def _named(result: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> str:
    each = []
    for effect in effects[:MOST_LISTED]:  # the numbers say that each member has its own
        place = {**effect, "location": str(effect["location"]).removeprefix(EACH_MEMBER)}
        joint = effect.get("joint") or ""
        drives = f" of joint {joint}" if joint and not place["location"].endswith(f":{joint}") else ""
        each.append(f"{effect_at_place(place)}{drives} ({parameters_in_words(effect)})")
    if len(effects) > MOST_LISTED:
        more = len(effects) - MOST_LISTED
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
    rival = model_beside(result) if believed <= steady else "constant velocity"
    return f", but {rival} predicts held-out recordings no worse: do not predict with the mended model."


def model_beside(result: Mapping[str, Any]) -> str:
    """The model that effects are beside."""
    return "the model from before" if result.get("before") else "the believed model"


def gap_levels(result: Mapping[str, Any]) -> tuple[float | None, float | None, float | None]:
    """The held-out gap before and after, and what noise leaves."""
    gap = result.get("gap") or {}
    before, after, nulls, floor = (as_float(gap.get(key)) for key in ("before", "after", "nulls", "noise_floor"))
    return before, after, nulls if nulls else floor


def _leaves_much(result: Mapping[str, Any]) -> bool:
    _, after, noise = gap_levels(result)
    return after is not None and bool(noise) and after > TIMES_NOISE * noise  # type: ignore[operator]


def _explained(result: Mapping[str, Any]) -> str:
    """How much of the disagreement on held-out data the named effects explain, and what the rest is."""
    before, after, noise = gap_levels(result)
    if before is None or after is None:
        return ""
    many = len(result.get("effects") or []) > 1
    it, explains = ("They", "explain") if many else ("It", "explains")
    unit = str((result.get("gap") or {}).get("unit") or "")
    if after >= before:
        return f"On {_UNUSED} the gap does not fall with {'them' if many else 'it'}: do not rely on this name."
    if "Delta_fitness" in unit:
        return f"{it} {explains} {share_in_words(1 - after / before)} of Delta_fitness on trials that were not used."
    if not noise:
        return f"{it} {explains} {share_in_words(1 - after / before)} of the disagreement on {_UNUSED}."
    if before <= _LITTLE * noise:
        return f"On {_UNUSED} the disagreement is close to the noise with and without {'them' if many else 'it'}."
    share = (before - after) / (before - min(noise, after))
    is_all = after <= _LITTLE * noise
    rest = "the rest is noise" if is_all else "more than noise is left"
    return f"{it} {explains} {share_in_words(share, is_all)} of the disagreement on {_UNUSED}{_joint(result)}; {rest}."


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


def share_in_words(share: float, is_all: bool = False) -> str:
    """A share in per cent; what is not all is not rounded to all."""
    value = 100 * min(share, 1.0)
    if value > 99.5 and not is_all:
        return "more than 99 %"
    return f"{value:.0f} %" if value >= 1 else f"{format_number(value, 1)} %"


def effect_and_place(row: Mapping[str, Any]) -> tuple[str, str]:
    """What an entry of results is about."""
    return str(row["effect"]), str(row["location"])


def rivals_of(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Candidates that these data cannot distinguish from what is named."""
    same = {effect_and_place(effect) for effect in result.get("effects") or []}
    return [entry for entry in result.get("equivalent") or [] if effect_and_place(entry) not in same]


def list_rivals(others: Sequence[Mapping[str, Any]]) -> str:
    """The first of them in words, and how many more there are."""
    more = f" (and {len(others) - MOST_LISTED} more)" if len(others) > MOST_LISTED else ""
    return " or ".join(effect_at_place(m) for m in others[:MOST_LISTED]) + more


def capitalised(text: str) -> str:
    """A text as the beginning of a sentence."""
    return text[:1].upper() + text[1:]
