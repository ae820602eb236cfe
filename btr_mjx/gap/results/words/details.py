"""What else there is to say of a verdict, one sentence a line, as part of result.json and of the page.

Every function returns words for numbers of result.json and computes nothing else.
"""

from collections.abc import Mapping
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results.diagnosis import NOISE_REACHED
from btr_mjx.gap.results.words.effects import effect_at_place, hypotheses_of, together_in_words
from btr_mjx.gap.results.words.levels import (
    MISFIT,
    MISFIT_AFTER,
    SCALE,
    Levels,
    joint_claims,
    joint_rows,
    misfit_in_words,
    off_by,
)
from btr_mjx.gap.results.words.mended import mended_statement
from btr_mjx.gap.results.words.statements import UNSAID, Claim, Statement
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
    list_rivals,
    model_beside,
    off_calibration,
    off_statement,
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
      Where simulation and data disagree, the misfit before and after, what the mended model is, the next best
      candidate, and what is equivalent.
    """
    return [one.text for one in detail_statements(result)]


def detail_statements(result: Mapping[str, Any]) -> list[Statement]:
    """The same with what each sentence claims."""
    verdict = result.get("verdict")
    where = result.get("where") if verdict == "effect" else None
    off = [] if result.get("before") or verdict == "none" else off_calibration(result)
    every = [
        Statement(f"Simulation and data disagree most at {where}." if where else ""),
        _misfit(result),
        _finer_step(result),
        _time_step(result),
        Statement(f"Before: {result['before']['sentence']}" if result.get("before") else ""),
        _whole_recordings(result),
        mended_statement(result),
        off_statement(off) if off else UNSAID,
        UNSAID if result.get("before") else _calibration(result),
        _runner_up(result) if verdict == "effect" else UNSAID,
        _best_candidate(result) if verdict == "unexplained" else UNSAID,
        Statement(_equivalent(result)),
    ]
    return [one for one in every if one.text]


def _misfit(result: Mapping[str, Any]) -> Statement:
    """How far predictions are off, on the one scale."""
    levels = Levels.of(result)
    if levels.before is None or levels.unit != "noise":
        return UNSAID
    before, after, steady = map(misfit_in_words, (levels.before, levels.after, levels.constant_velocity))
    ahead = f"{joint_rows(result)[0]['horizon']:g} s" if joint_rows(result) else "a short time"
    of = f"The misfit of predictions over {ahead} on held-out recordings"
    claims: dict[str, Claim] = {MISFIT: before}
    words = f"is {before}"
    if levels.after is not None:
        claims |= {MISFIT_AFTER: after, "falls": bool(levels.falls)}
        words = f"{'falls' if levels.falls else 'does not fall: it goes'} from {before} to {after}"
    also = ""
    if levels.constant_velocity is not None:
        also, claims = f"; constant velocity has {steady}", claims | {"misfit of constant velocity": steady}
    return Statement(f"{of} {words} ({SCALE}, root mean square over joints){also}.", claims)


def _time_step(result: Mapping[str, Any]) -> Statement:
    """A time step of the model that hides more than noise does."""
    sizes = [(as_float(row.get("time_step")), as_float(row.get("noise")), row) for row in joint_rows(result)]
    coarse = [(step / noise, row) for step, noise, row in sizes if step and noise and step > NOISE_REACHED * noise]
    if not coarse:
        return UNSAID
    _, row = max(coarse, key=lambda one: one[0])
    step, noise = off_by(row, "time_step"), off_by(row, "noise")
    return Statement(
        f"The time step of the model is coarse: it alone makes {step} at {row['joint']}, noise {noise}, and what is "
        "smaller cannot be told; take a smaller one.",
        joint_claims(row, "time_step", "noise"),
    )


def _finer_step(result: Mapping[str, Any]) -> Statement:
    """A time step of the search that is finer than the model's."""
    of = result.get("timestep") or {}
    own, finer = as_float(of.get("model")), as_float(of.get("search"))
    if own is None or finer is None or finer >= own:
        return UNSAID
    return Statement(
        f"The time step of the model, {1e3 * own:g} ms, is too coarse: the search and mended.xml have "
        f"{1e3 * finer:g} ms."
    )


def _calibration(result: Mapping[str, Any]) -> Statement:
    """What the mended model has within the usual tolerances."""
    off = [effect_and_place(row) for row in off_calibration(result)]
    found = [row for row in result.get("calibration") or [] if effect_and_place(row) not in off]
    if not found:
        return UNSAID
    each = [f"{effect_at_place(row)} ({parameters_in_words(row)})" for row in found[:MOST_LISTED]]
    more = f" and {len(found) - MOST_LISTED} more, listed in result.json" if len(found) > MOST_LISTED else ""
    return Statement(f"The mended model is calibrated within the usual tolerances: {', '.join(each)}{more}.")


def _whole_recordings(result: Mapping[str, Any]) -> Statement:
    """How well whole recordings are followed."""
    of = result.get("open_loop") or {}
    start, end, unit = as_float(of.get("before")), as_float(of.get("after")), str(of.get("unit"))
    if start is None or end is None or "and" in unit:
        return UNSAID
    first, last = (error_in_words(value, unit) for value in (start, end))
    whole = "The mean position error over whole held-out recordings, simulated from their first sample,"
    claims: dict[str, Claim] = {"open loop": first, "open loop after": last}
    if end < start:
        return Statement(f"{whole} falls from {first} to {last}.", claims)
    return Statement(
        f"{whole} is {first} with {model_beside(result)} and {last} with the mended one: where small differences grow, "
        "a motion can be followed over short stretches only.",
        claims,
    )


def _alone(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Candidates of the ranking that were tried without others."""
    return [row for row in result.get("ranking") or [] if not row.get("beside")]


def _runner_up(result: Mapping[str, Any]) -> Statement:
    same = {effect_and_place(effect) for effect in result.get("effects") or []}
    named = [row for row in _alone(result) if effect_and_place(row) in same]
    others = [
        rows
        for rows in hypotheses_of(_alone(result))
        if not any(row.get("equivalent") or effect_and_place(row) in same for row in rows)
    ]
    # A name may be what is left of the best hypothesis of several effects, which is not its rival.
    best, top = (as_float(rows[0].get("score")) if rows else None for rows in (named, _alone(result)[:1]))
    others = [rows for rows in others if not (len(rows) > 1 and as_float(rows[0].get("score")) == top)]
    if not others:
        return UNSAID
    second, what = as_float(others[0][0].get("score")), together_in_words(others[0])
    if best is None or second is None or best <= 0:
        return Statement(f"Runner-up: {what}.")
    if second > best:
        return Statement(
            f"{capitalised(what)} scores more and may not be named: it gains too little on held-out recordings, or "
            "errors of calibration explain as much."
        )
    share = second / best
    how = "far behind" if share < 0.6 else "behind" if share < 0.9 else "close behind"
    alike = any(row.get("equivalent") and effect_and_place(row) not in same for row in _alone(result))
    first = "The next best that is not equivalent" if alike else "Runner-up"
    said = f"{100 * max(share, 0):.0f} %"
    return Statement(f"{first}: {what}, {how} ({said} of the score).", {f"score of {what}": said})


def _best_candidate(result: Mapping[str, Any]) -> Statement:
    """The candidate that comes nearest where nothing is named."""
    rows = next(iter(hypotheses_of(_alone(result))), [])
    score, share = (as_float(rows[0].get("score")) if rows else None), as_float(result.get("share"))
    if score is None or score <= 0:
        return UNSAID
    part = f" explains {share_in_words(share)} of the unknown force and" if share is not None and share > 0 else ""
    return Statement(f"The best candidate, {together_in_words(rows)},{part} leaves too much to be named.")


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
