"""A section of docs/machines.md for each machine: what it is, a curve, what was named with numbers, what is left."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rivals import GAINS

from btr_mjx.gap.results import estimate_cells, in_percent, unit_in_words

PICTURES = "images/machines"
"""Folder of the pictures beside the page."""
SHOWN = 2
"""Places that are told where something is unexplained."""
ZERO = re.compile(r"−(?=0(\.0+)?(?![\d.]))")
"""The sign of a number that was rounded to zero."""
USUAL = re.compile(r"Predictions of held-out|\S+\.parquet: ")
"""Notes of a diagnosis that the table says already, or that only concern how it is computed."""


def agreed(half: Mapping[str, Any]) -> str:
    """What the diagnoses of both halves have in common, in words."""
    if not (half["both"] or half["first_only"] or half["second_only"]):
        return "neither names anything"
    named = "the same names" if half["same_names"] else f"both name {', '.join(half['both']) or 'nothing alike'}"
    only = [*half["first_only"], *half["second_only"]]
    alone = f"; one of them only: {', '.join(only)}" if only else ""
    if not half["numbers"]:
        return f"{named}{alone}"
    return f"{named}{alone}; {half['overlap']} of {half['numbers']} intervals overlap"


def cell(error: float | str | None) -> str:
    """An error with three digits; "-" where there is none."""
    if error is None:
        return "-"
    size = float(error)
    if not math.isfinite(size):
        return "diverged"
    return f"{size:.0f}" if size >= 100 else f"{size:.3g}"


def interval(parameter: Mapping[str, Any]) -> str:
    """A number and its interval: "0.31 [0.28, 0.34]"."""
    cells = estimate_cells(parameter)
    more = " (edge of what is tried)" if parameter.get("edge") else ""
    return ZERO.sub("", f"{cells['value']} [{cells['low']}, {cells['high']}]{more}")


def numbers(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines of a table: a row a joint or other place, a column a kind of number."""
    rows: dict[str, dict[str, str]] = {}
    columns: dict[str, None] = {}  # as a set that keeps the order of the effects
    for effect in effects:
        several = len({name.partition("[")[0] for name in effect["parameters"]}) > 1
        for name, found in effect["parameters"].items():
            kind, _, member = name.partition("[")
            parameter = in_percent(name, found)
            place = member.removesuffix("]") or effect["location"].partition(":")[2] or effect["location"]
            column = " ".join([effect["effect"], *([kind] if several else [])]).replace("_", " ")
            unit = unit_in_words(parameter.get("unit"))
            column = f"{column} [{unit}]" if unit else column
            columns[column] = None
            rows.setdefault(place, {})[column] = interval(parameter)
    lines = [f"| | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    return lines + [f"| {place} | {' | '.join(row.get(key, '') for key in columns)} |" for place, row in rows.items()]


def said(row: Mapping[str, Any]) -> str:
    """What a diagnosis explains and what it leaves, in sentences."""
    if row["refused"] or row["failed"]:
        return f"The diagnosis gave no result: {row['refused'] or row['failed']}"
    verdict = str(row["sentence"])
    parts = [verdict.rpartition(". ")[2] if row["effects"] else verdict]  # the names are in the table
    return " ".join(parts + [_sentence(t) for t in row.get("unexplained", [])[:SHOWN] if t not in verdict])


def section(row: Mapping[str, Any], pictures: Path) -> list[str]:
    """Lines of the section of a machine.

    Args:
      row: of the benchmark's JSON.
      pictures: folder of the pictures; a machine without one gets none.
    """
    lines = [f"### {row['name']}", ""]
    lines += [" ".join(part.split()) + "\n" for part in row.get("about", "").strip().split("\n\n") if part]
    lines += [f"Data: {row['source']}; licence: {row['licence']}. {row['citation']}. Split: {row['split']}.", ""]
    if (pictures / f"{row['name']}.svg").is_file():
        lines += [f"![Measured and predicted motion of {row['name']}]({PICTURES}/{row['name']}.svg)", ""]
    if shown := row.get("curve"):
        start = "" if row["horizon"] is None else f", from {shown['start']:.2f} s on"
        lines += [f"Held out: {shown['coordinate']} in recording {shown['recording']}{start}.", ""]
    if row.get("effects"):
        lines += [*numbers(row["effects"]), ""]
    lines += [said(row), "", f"- *specialists*: {_specialists(row)}{row['figure']}."]
    if own := row.get("toolbox"):
        lines.append(f"- *mujoco.sysid*: {_toolbox(row, own)}.")
    if half := row.get("halves"):
        lines.append(f"- *halves of the recordings*: {half.get('refused') or agreed(half)}.")
    lines += [f"- *noted*: {_sentence(note)}" for note in row.get("notes", []) if not USUAL.match(note)]
    return [*lines, f"- *time*: {row['cpu_seconds']:.0f} CPU-seconds.", ""]


def _specialists(row: Mapping[str, Any]) -> str:
    """Their errors, with a colon; nothing where there are none."""
    errors = {key: row["errors"].get(key) for key in ("published", "known")}
    own = "" if errors["published"] is None else f"{cell(errors['published'])} {row['unit']}"
    known = "" if errors["known"] is None else f"{cell(errors['known'])} {row['unit']} with their numbers"
    both = ", ".join(text for text in (own, known) if text)
    return f"{both}: " if both else ""


def _toolbox(row: Mapping[str, Any], own: Mapping[str, Any]) -> str:
    if "refused" in own:
        return str(own["refused"])
    stopped = "" if own["ended"] else ", stopped before it ended"
    edge = sum(not GAINS[0] * 1.001 < gain < GAINS[1] * 0.999 for gain in own["gain"])
    gains = f"; {edge} of {len(own['gain'])} gains at the bound of {GAINS[0]:g} or {GAINS[1]:g}" if edge else ""
    error = f"{cell(row['errors']['toolbox'])} {row['unit']}"
    return f"{error}, delay {1e3 * own['delay']:.1f} ms{gains}; {own['cpu_seconds']:.0f} CPU-seconds{stopped}"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].removesuffix(".") + "."
