"""What a mended model is, in words: on the page, in result.json, and in the first line of mended.xml."""

from collections.abc import Mapping
from typing import Any

from btr_mjx.gap.results.words.levels import MISFIT, MISFIT_AFTER, Levels, misfit_in_words
from btr_mjx.gap.results.words.statements import UNSAID, Claim, Statement

MENDED_FILE = "mended.xml"
"""File of the mended model in a run folder."""

FINER_STEP = "finer time step"
"""Kind of a mended model that differs from the believed one in its time step alone."""

_KINDS: Mapping[str, str] = {
    "explained": "the {model} with what was named",
    "partly explained": "the {model} with what was named, which is a part of what is missing",
    "unnamed": "the {model} with numbers that may not be called by name, since something else is missing beside them",
    "calibrated": "the {model} with calibration alone, in which nothing has a name",
    FINER_STEP: "the {model} with a finer time step alone",
}


def mended_in_words(result: Mapping[str, Any]) -> str:
    """What the mended model is, such as "the believed model with what was named"; "" where there is none."""
    model = "model from before" if result.get("before") else "believed model"
    kind = (result.get("mended") or {}).get("kind")
    return _KINDS[kind].format(model=model) if kind else ""


def mended_statement(result: Mapping[str, Any]) -> Statement:
    """The mended model and how well it predicts."""
    what, levels = mended_in_words(result), Levels.of(result)
    if not what:
        return UNSAID
    how, claims = "", dict[str, Claim]()
    if levels.unit == "noise" and levels.falls is not None:
        before, after = misfit_in_words(levels.before), misfit_in_words(levels.after)
        claims = {MISFIT: before, MISFIT_AFTER: after, "falls": levels.falls}
        better = "better" if levels.falls else "no better"
        how = f": it predicts held-out recordings {better} (a misfit of {after} against {before})"
    return Statement(f"{MENDED_FILE} is {what}{how}.", claims)


def header_comment(result: Mapping[str, Any]) -> str:
    """The first line of mended.xml, which says what it is."""
    text = mended_statement(result).text or f"{MENDED_FILE} is the believed model."
    return f"<!-- {text.replace('--', '-')} -->\n"
