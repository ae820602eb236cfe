"""The verdict of a diagnosis in at most two sentences, which are part of result.json and of the page.

Every function returns words for numbers of result.json and computes nothing else; `details` says the rest.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results.records import BEYOND_TOLERANCE
from btr_mjx.gap.results.words.changes import SAME_REST, UNCHANGED, change_in_words
from btr_mjx.gap.results.words.effects import effect_at_place, place_in_words, quantity_at_place
from btr_mjx.gap.results.words.levels import Levels, joint_claims, joint_rows, off_by, worst_joint
from btr_mjx.gap.results.words.statements import UNSAID, Claim, Statement, joined
from btr_mjx.gap.results.words.terms import as_float, format_number, parameters_in_words, size_in_words

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
    return joined(verdict_statements(result))


def verdict_statements(result: Mapping[str, Any]) -> list[Statement]:
    """The same with what each sentence claims."""
    verdict, effects = result.get("verdict"), list(result.get("effects") or [])
    if result.get("before"):
        return _change_statements(result, effects)
    if verdict == "effect" and effects:
        return [_named(result, effects), _explained(result)]
    if verdict == "none":
        return _nothing(result)
    text = f"Something is missing that none of the known effects explains{_looks(result)}"
    return [Statement(text, _level(result) | {"something is missing": True})]


def _level(result: Mapping[str, Any]) -> dict[str, Claim]:
    """The claim whether predictions are at the noise's level, where noise is known."""
    reached = Levels.of(result).noise_reached
    return {} if reached is None else {"noise reached": reached}


def _not_reached(result: Mapping[str, Any]) -> dict[str, Claim]:
    """The claim that more than noise is left, where noise is known."""
    return {} if Levels.of(result).noise_reached is None else {"noise reached": False}


def _looks(result: Mapping[str, Any]) -> str:
    """How small what is unexplained is, where it is, and what it looks like."""
    where = f", most of it at {result['where']}" if result.get("where") else ""
    if Levels.of(result).noise_reached:
        where = f", too little to be seen in short predictions{where}"
    looks = result.get("unexplained") or []
    return f"{where}." + (f" It looks like this: {looks[0].rstrip('.')}." if looks else "")


def _nothing(result: Mapping[str, Any]) -> list[Statement]:
    """Nothing is missing: what the numbers say of noise, of calibration, and of candidates."""
    levels, off = Levels.of(result), off_calibration(result)
    others = list_rivals(rivals_of(result))
    nothing = "Nothing need be missing" if result.get("equivalent") else "Nothing is missing"
    first: dict[str, Claim] = {"something is missing": False}
    if levels.noise_reached:
        within = "the noise" if off else "the noise and the usual tolerances"
        said = Statement(
            f"{nothing}: simulation and data agree within {within}{_once_set_right(off)}.",
            first | {"noise reached": True},
        )
    elif levels.noise_reached is None:
        said = Statement(f"{nothing}: no effect explains more than the usual tolerances do.", first)
    else:
        row = worst_joint(joint_rows(result), "before" if levels.after is None else "after")
        assert row is not None
        key = "before" if levels.after is None else "after"
        said = Statement(
            f"No effect is missing beyond the usual tolerances, though more than noise is left: {_ahead(row)}, "
            f"{row['joint']} is off by {off_by(row, key)}, where noise and the time step make {off_by(row, 'floor')}.",
            first | {"noise reached": False} | joint_claims(row, key, "floor"),
        )
    if off:
        return [said, off_statement(off)]
    return [said, Statement(f"{capitalised(others)} is not ruled out.")] if others else [said]


def _once_set_right(off: Sequence[Mapping[str, Any]]) -> str:
    return " once calibration is set right" if off else ""


def off_calibration(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Calibration that is farther off than robots usually are, the farthest first."""
    rows = [row for row in result.get("calibration") or [] if (as_float(row.get("tolerances")) or 0) > BEYOND_TOLERANCE]
    return sorted(rows, key=lambda row: -row["tolerances"])


def off_statement(off: Sequence[Mapping[str, Any]]) -> Statement:
    """Numbers of the model that are wrong by more than calibration usually leaves."""
    each = []
    claims: dict[str, Claim] = {}
    for row in off[:MOST_LISTED]:
        size = f"{format_number(row['tolerances'], 2)} times its tolerance"
        what = f"{quantity_at_place(row)} is off by {size_in_words(row)} ({size})"
        each.append(what)
        claims[f"off: {effect_at_place(row)}"] = size
    more = f" and {len(off) - MOST_LISTED} more, listed in result.json" if len(off) > MOST_LISTED else ""
    return Statement(f"{capitalised('; '.join(each))}{more}.", claims)


def _change_statements(result: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> list[Statement]:
    """What has changed since the recordings before."""
    levels = Levels.of(result)
    if result.get("verdict") == "effect" and effects:
        text, claims = _no_use(result)
        return [Statement(f"{change_in_words(effects, MOST_LISTED)}{text}", claims), _explained(result)]
    if result.get("verdict") == "none":
        if levels.noise_reached:
            return [Statement(UNCHANGED, {"noise reached": True})]
        return [Statement(SAME_REST, _not_reached(result))]
    if result["before"].get("verdict") == "unexplained":
        text = f"What has changed cannot be told: no known effect explains the recordings before either{_looks(result)}"
    else:
        text = f"Something has changed that none of the known effects explains{_looks(result)}"
    return [Statement(text, _level(result))]


def _named(result: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> Statement:
    each = []
    for effect in effects[:MOST_LISTED]:  # the numbers say that each member has its own
        place = {**effect, "location": str(effect["location"]).removeprefix(EACH_MEMBER)}
        joint = effect.get("joint") or ""
        drives = f" of joint {joint}" if joint and not place["location"].endswith(f":{joint}") else ""
        each.append(f"{effect_at_place(place)}{drives} ({parameters_in_words(effect)})")
    if len(effects) > MOST_LISTED:
        more = len(effects) - MOST_LISTED
        each.append(f"{more} more effect{'s' if more > 1 else ''}, listed in the table")
    levels = Levels.of(result)
    is_part = levels.noise_reached is False
    claims: dict[str, Claim] = {"something is missing": True}
    if is_part:
        claims["noise reached"] = False
    subject = f"The missing effect{'s are' if len(effects) > 1 else ' is'}"
    subject = "A part of what is missing is" if is_part else subject
    use, more_claims = _no_use(result)
    return Statement(f"{subject} {' and '.join(each)}{use}", claims | more_claims)


def _no_use(result: Mapping[str, Any]) -> tuple[str, dict[str, Claim]]:
    """The end of the first sentence: whether the mended model predicts no better than two simple predictors."""
    levels = Levels.of(result)
    if levels.is_of_use:
        return ".", {}
    rival = "constant velocity" if levels.falls else model_beside(result)
    said = f", but {rival} predicts held-out recordings no worse: do not predict with the mended model."
    return said, {"mended model is of use": False}


def model_beside(result: Mapping[str, Any]) -> str:
    """The model that effects are beside."""
    return "the model from before" if result.get("before") else "the believed model"


def _explained(result: Mapping[str, Any]) -> Statement:
    """How much of the disagreement on held-out data the named effects explain, and what the rest is."""
    levels = Levels.of(result)
    if levels.falls is None:
        return UNSAID
    many = len(result.get("effects") or []) > 1
    it, explains = ("They", "explain") if many else ("It", "explains")
    if not levels.falls:
        text = f"On {_UNUSED} predictions are no better with {'them' if many else 'it'}: do not rely on this name."
        return Statement(text, {"falls": False})
    if levels.unit != "noise":
        share = share_in_words(levels.explained or 0.0)
        return Statement(f"{it} {explains} {share} of Delta_fitness on trials that were not used.", {"share": share})
    if levels.noise_before:
        text = f"On {_UNUSED} predictions are close to the noise with and without {'them' if many else 'it'}."
        return Statement(text, {"falls": True, "noise reached": True, "believed model reaches noise": True})
    share = share_in_words(levels.explained or 0.0, bool(levels.noise_reached))
    joint, claims = _joint(result)
    rest = "the rest is noise"
    if not levels.noise_reached:
        worst = worst_joint(joint_rows(result), "after")
        rest = "more than noise is left" + (f", most of it at {worst['joint']}" if worst is not None else "")
    claims = claims | {"share": share, "falls": True, "noise reached": bool(levels.noise_reached)}
    return Statement(f"{it} {explains} {share} of the disagreement on {_UNUSED}{joint}; {rest}.", claims)


def _ahead(row: Mapping[str, Any]) -> str:
    return f"predicted over {row['horizon']:g} s"


def _joint(result: Mapping[str, Any]) -> tuple[str, dict[str, Claim]]:
    """Errors of the named joint, else of the one that is worst beside its noise, before and after."""
    rows = joint_rows(result)
    named = {place_in_words(str(effect["location"])) for effect in result.get("effects") or []}
    row = worst_joint([row for row in rows if row["joint"] in named] or rows, "before")
    if row is None:
        return "", {}
    before, after, floor = (off_by(row, key) for key in ("before", "after", "floor"))
    off = f"{row['joint']} is off by {after} instead of {before}, where noise and the time step make {floor}"
    return f": {_ahead(row)}, {off}", joint_claims(row, "before", "after", "floor")


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
