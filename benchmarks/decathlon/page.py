"""What docs/machines.md shows of the benchmark, between marks: the table of all machines and a section of each."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sections import PICTURES, cell, section

from btr_mjx.errors import InputError

TITLES = (
    "machine",
    "unit, over",
    "believed",
    "mended",
    "constant velocity",
    "regression",
    "mujoco.sysid",
    "specialists",
)
HEAD = (*TITLES, "named", "licence of the data", "citation")
OWN = ("believed", "mended")
ERRORS = (*OWN, "steady", "regression", "toolbox", "published")
"""Errors of the table, in its order; that with the specialists' numbers stands in brackets behind theirs."""
COMPARED = (*OWN, "toolbox", "published", "known")
"""Errors of which the smallest is bold."""
MARKS = "<!-- {}: made by benchmarks/decathlon.py -->", "<!-- end of {} -->"
"""Lines around a generated part."""


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
        best = cell(min(float(errors[key]) for key in COMPARED if errors.get(key) is not None))
        sizes = {key: cell(errors.get(key)) for key in ERRORS}
        sizes |= {key: f"**{sizes[key]}**" for key in COMPARED[:-1] if sizes[key] == best}
        if errors.get("known") is not None:
            known = cell(errors["known"])
            sizes["published"] += f" ({f'**{known}**' if known == best else known})"
        over = "whole recordings" if row["horizon"] is None else f"{row['horizon']:g} s"
        said = "refused" if row["refused"] else names(row) or row.get("verdict") or "failed"
        name = f"[{row['name']}](#{row['name']})"
        cells = (name, f"{row['unit']}, {over}", *sizes.values(), said, row["licence"], row["citation"])
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def write_page(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Put the table and the sections into a page, in place of those between its marks; the rest stays as it is.

    Args:
      rows: of the benchmark's JSON.
      path: of the page; pictures lie beside it.

    Raises:
      InputError: the page lacks a mark.
    """
    sections = [line for row in rows for line in section(row, path.parent / PICTURES)]
    lines = path.read_text().splitlines()
    for part, made in (("table", table(rows)), ("sections", sections)):
        try:
            first, last = (lines.index(mark.format(part)) for mark in MARKS)
        except ValueError as error:
            raise InputError(f"{path}: lacks one of the lines {', '.join(m.format(part) for m in MARKS)}") from error
        lines[first + 1 : last] = ["", *"\n".join(made).strip().splitlines(), ""]
    path.write_text("\n".join(lines) + "\n")
