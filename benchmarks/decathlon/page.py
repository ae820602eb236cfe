"""The table of docs/machines.md, and how numbers and names are written."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.errors import InputError

TITLES = ("machine", "unit, over", "believed", "mended", "constant velocity", "regression", "specialists")
HEAD = (*TITLES, "named", "licence of the data", "citation")
OWN = ("believed", "mended")
ERRORS = (*OWN, "steady", "regression", "published")
"""Errors of the table, in its order; that with the specialists' numbers stands in brackets behind theirs."""


def cell(error: float | str | None) -> str:
    """An error with three digits; "-" where there is none."""
    if error is None:
        return "-"
    size = float(error)
    if not math.isfinite(size):
        return "diverged"
    return f"{size:.0f}" if size >= 100 else f"{size:.3g}"


def names(row: Mapping[str, Any]) -> str:
    """What was named, kind by kind, with its place or the number of its places."""
    places: dict[str, list[str]] = {}
    for effect in row.get("effects") or []:
        place = effect["location"].partition(":")[2] or effect["location"]
        places.setdefault(effect["effect"].replace("_", " "), []).append(place)
    return ", ".join(f"{kind} ({own[0] if len(own) == 1 else f'{len(own)} places'})" for kind, own in places.items())


def table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines of the table in Markdown; bold is the smallest error beside constant velocity and regression.

    Args:
      rows: of the benchmark's JSON.
    """
    lines = [f"| {' | '.join(HEAD)} |", "|" + "---|" * len(HEAD)]
    for row in rows:
        errors = row["errors"]
        best = cell(min(float(errors[key]) for key in (*OWN, "published", "known") if errors.get(key) is not None))
        sizes = {key: cell(errors.get(key)) for key in ERRORS}
        sizes |= {key: f"**{sizes[key]}**" for key in (*OWN, "published") if sizes[key] == best}
        if errors.get("known") is not None:
            known = cell(errors["known"])
            sizes["published"] += f" ({f'**{known}**' if known == best else known})"
        over = "whole recordings" if row["horizon"] is None else f"{row['horizon']:g} s"
        said = "refused" if row["refused"] else names(row) or row.get("verdict") or "failed"
        cells = (row["name"], f"{row['unit']}, {over}", *sizes.values(), said, row["licence"], row["citation"])
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def write_page(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Put the table into a page, in place of the one that is there.

    Raises:
      InputError: the page has no such table.
    """
    lines = path.read_text().splitlines()
    first = next((i for i, line in enumerate(lines) if line.startswith(f"| {HEAD[0]} |")), None)
    if first is None:
        raise InputError(f"{path}: has no table that begins with | {HEAD[0]} |")
    last = next((i for i in range(first, len(lines)) if not lines[i].startswith("|")), len(lines))
    path.write_text("\n".join([*lines[:first], *table(rows), *lines[last:]]) + "\n")
