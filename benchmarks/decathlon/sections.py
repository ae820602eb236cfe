"""A section of docs/machines.md for each machine: what it is, a curve, what was named with numbers, what is left."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.gap.results import effect_title, estimate_cells, format_number, parameter_in_words, unit_in_words

PICTURES = "images/machines"
"""Folder of the pictures beside the page."""
SHOWN = 2
"""Places that are told where something is unexplained."""
USUAL = re.compile(r"Predictions of held-out|\S+\.parquet: ")
"""Notes of a diagnosis that the table says already, or that only concern how it is computed."""


def agreed(half: Mapping[str, Any]) -> str:
    """What the diagnoses of both halves have in common, in words."""
    named = "the same names" if half["same_names"] else f"both name {', '.join(half['both']) or 'nothing alike'}"
    only = [*half["first_only"], *half["second_only"]]
    alone = f"; one of them only: {', '.join(only)}" if only else ""
    return f"{named}{alone}; {half['overlap']} of {half['numbers']} intervals overlap"


def interval(parameter: Mapping[str, Any]) -> str:
    """A number and its interval: "0.31 [0.28, 0.34]"."""
    cells = estimate_cells(parameter)
    more = " (edge of what is tried)" if parameter.get("edge") else ""
    return f"{cells['value']} [{cells['low']}, {cells['high']}]{more}"


def numbers(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines of a table: a row a joint or other place, a column a kind of number."""
    rows: dict[str, dict[str, str]] = {}
    columns: list[str] = []
    for effect in effects:
        several = len({name.partition("[")[0] for name in effect["parameters"]}) > 1
        for name, parameter in effect["parameters"].items():
            kind, _, member = name.partition("[")
            place = member.removesuffix("]") or effect["location"].partition(":")[2] or effect["location"]
            title = effect_title(effect["effect"]) + (f", {parameter_in_words(kind)}" if several else "")
            unit = unit_in_words(parameter.get("unit"))
            column = f"{title} [{unit}]" if unit else title
            columns += [column] if column not in columns else []
            rows.setdefault(place, {})[column] = interval(parameter)
    lines = [f"| | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    return lines + [f"| {place} | {' | '.join(row.get(key, '') for key in columns)} |" for place, row in rows.items()]


def left(row: Mapping[str, Any]) -> str:
    """What a diagnosis leaves, in sentences."""
    if row["refused"] or row["failed"]:
        return f"The diagnosis gave no result: {row['refused'] or row['failed']}"
    said = str(row["sentence"])
    parts = [said.rpartition(". ")[2] if row["effects"] else said]  # names are in the table
    parts += [_sentence(text) for text in row.get("unexplained", [])[:SHOWN] if text not in said]
    parts += [_sentence(note) for note in row.get("notes", []) if not USUAL.match(note)]
    return " ".join(parts)


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
        shown = row.get("curve")
        where = f": recording {shown['recording']} from {format_number(shown['start'])} s on" if shown else ""
        lines += [f"![Measured and predicted motion of {row['name']}]({PICTURES}/{row['name']}.svg)", ""]
        lines += [f"Held out{where}.", ""] if where else []
    if row.get("effects"):
        lines += [*numbers(row["effects"]), ""]
    lines += [f"- *left*: {left(row)}", f"- *specialists*: {row['figure']}."]
    if (own := row.get("toolbox")) and own.get("refused"):
        lines.append(f"- *mujoco.sysid*: {own['refused']}.")
    if half := row.get("halves"):
        lines.append(f"- *halves*: {half.get('refused') or agreed(half)}.")
    return [*lines, f"- *time*: {row['cpu_seconds']:.0f} CPU-seconds.", ""]


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].removesuffix(".") + "."
