"""Tables of the page about a diagnosis, from its saved files; no table where there is nothing to show."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results import (
    REASON_NOT_NAMED,
    effect_at_place,
    effect_title,
    estimate_cells,
    format_number,
    hypothesis_in_words,
    in_percent,
    in_reading_unit,
    parameter_in_words,
    place_in_words,
    unit_in_words,
)
from btr_mjx.pages import Section, Table
from btr_mjx.runs import read_arrays, read_table

_CANDIDATES = 14
"""Candidates that the page shows unfolded, at most."""


def effect_table(result: Mapping[str, Any]) -> list[Table]:
    """Numbers of the named effects with their intervals."""
    rows = []
    for effect in result.get("effects") or []:
        place = place_in_words(str(effect["location"]).removeprefix(EACH_MEMBER))
        for name, given in effect["parameters"].items():
            cells = estimate_cells(in_percent(name, given)).values()
            unit = unit_in_words(in_percent(name, given).get("unit"))
            rows.append([effect_title(effect["effect"]), place, parameter_in_words(name), *cells, unit])
    note = str(result.get("interval_note") or "From, to: 90 % interval; it does not assume that the fit is good.")
    return [Table(["effect", "place", "parameter", "value", "from", "to", "unit"], rows, note)] if rows else []


def table_over_sets(folder: Path) -> list[Table]:
    """Numbers over sets of recordings."""
    if not (folder / "sets.csv").is_file():
        return []
    rows = [
        {"set": row["name"], "number": f"{effect_at_place(row)}, {parameter_in_words(row['parameter'])}"}
        | {"value": row["value"], "from": row["low"], "to": row["high"]}
        | {"unit": unit_in_words(row["unit"]), "named": "yes" if row["named"] else ""}
        for row in read_table(folder / "sets.csv").to_dicts()
    ]
    note = (
        "Numbers beside the believed model, the oldest set first, with 90 % intervals. Named: said to be missing in "
        "the first set, to have changed in a later one."
    )
    return as_table(rows, note)


def joint_error_table(result: Mapping[str, Any]) -> list[Table]:
    """Errors of predictions in degrees or millimetres."""
    found = result.get("joint_errors") or []
    if not found:
        return []
    keys = ("before", "after", "noise") if result.get("effects") or result.get("calibration") else ("before", "noise")
    rows = [
        (row["joint"], *(in_reading_unit(float(row[key]), row["unit"])[0] for key in keys), reading_unit(row["unit"]))
        for row in found
    ]
    names = {"before": "believed model", "after": "mended model", "noise": "noise alone"}
    ahead = f"{found[0]['horizon']:g} s after a measured state"
    note = f"Root mean square error of positions of held-out recordings, {ahead}."
    return [Table(["joint", *(names[key] for key in keys), "unit"], rows, note)]


def reading_unit(unit: str) -> str:
    """Unit in which a reader sees an error of positions."""
    return str(in_reading_unit(0.0, unit)[1])


def disagreement_tables(folder: Path) -> list[Table]:
    """The map of disagreement by part and regime, before and after."""
    if not (folder / "disagreement.npz").is_file():
        return []
    data = read_arrays(folder / "disagreement.npz")
    note = (
        "Mean square of the force that would make the {} model follow the data, in units of the value that noise alone "
        "would give: 1 is the noise floor, – marks a regime without data."
    )
    return [
        Table(
            ["part", *map(str, data["columns"])],
            [(str(part), *map(_two_digits, row)) for part, row in zip(data["rows"], data[key], strict=True)],
            note.format(model),
        )
        for key, model in (("before", "believed"), ("after", "mended"))
        if key in data
    ]


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def candidate_sections(result: Mapping[str, Any]) -> list[Section]:
    """The ranking, and what these data cannot distinguish."""
    ranking, given, effects = (result.get(key) or [] for key in ("ranking", "equivalent", "effects"))
    if not ranking:
        return []
    found = {(one["effect"], one["location"]) for one in effects}
    rows = []
    for row in ranking:
        is_named = (row["effect"], row["location"]) in found
        word = "named" if is_named else "alike" if row.get("equivalent") else ""
        beside = hypothesis_in_words(" + ".join(row.get("beside") or []))
        given_numbers = [row.get(key) for key in ("score", "margin", "held_out")]
        numbers = [None if value == "NaN" else value for value in given_numbers]
        rows.append([effect_title(row["effect"]), place_in_words(row["location"]), *numbers, word, beside])
    names = ("effect", "place", "score", "behind the first", "held-out gain", "note", "beside")
    alike = "these data cannot distinguish it from the named one" if effects else REASON_NOT_NAMED
    note = f"Score: fall of the misfit (χ²), less a price for the effect's parameters. Alike: {alike}."
    if threshold := result.get("threshold"):
        note += f" A name needs a score of {format_number(threshold)} at least."
    first = [row for row in ranking if not row.get("beside")]
    if len(effects) == 1 and any(row["score"] > first[0]["score"] for row in first):
        note += (
            " What scores more than the name does not meet the other conditions for a name: it gains too little on "
            "held-out recordings, or errors of calibration explain as much."
        )
    lines = []
    if given and (len(given) > 1 or not effects):
        what = "These data cannot distinguish" if effects else f"Not ruled out, though {REASON_NOT_NAMED}"
        lines = [f"{what}: {'; '.join(effect_at_place(one) for one in given)}."]
    more = [_filled(names, rows[_CANDIDATES:])] if len(rows) > _CANDIDATES else []
    return [
        Section("Candidates", lines, tables=[_filled(names, rows[:_CANDIDATES], note)]),
        Section("More candidates", tables=more, folded=True),
    ]


def _filled(columns: Sequence[str], rows: Sequence[Sequence[Any]], note: str = "") -> Table:
    """A table without the columns that have empty cells only."""
    shown = [k for k in range(len(columns)) if any(row[k] not in (None, "") for row in rows)]
    return Table([columns[k] for k in shown], [[row[k] for k in shown] for row in rows], note)


def as_table(rows: Sequence[Mapping[str, Any]], note: str = "") -> list[Table]:
    """Mappings of the same keys as a table; none of none."""
    names = [str(name).replace("_", " ") for name in rows[0]] if rows else []
    return [Table(names, [list(row.values()) for row in rows], note)] if rows else []
