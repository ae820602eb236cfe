"""Tables of the page about a diagnosis, from its saved files; no table where there is nothing to show."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results import (
    REASON_NOT_NAMED,
    SCALE,
    as_float,
    effect_at_place,
    effect_title,
    enumerated,
    estimate_cells,
    format_number,
    hypotheses_of,
    hypothesis_in_words,
    in_percent,
    in_reading_unit,
    joint_rows,
    misfit_in_words,
    off_calibration,
    parameter_in_words,
    place_in_words,
    quantity_at_place,
    score_in_words,
    size_in_words,
    times_noise,
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


def calibration_table(result: Mapping[str, Any]) -> list[Table]:
    """Calibration that is farther off than robots usually are."""
    rows = [
        [quantity_at_place(row), size_in_words(row), format_number(row["tolerances"], 2)]
        for row in off_calibration(result)
    ]
    note = "The model's numbers are off by so much more than calibration usually leaves: a finding about the model."
    return [Table(["number", "off by", "times its tolerance"], rows, note)] if rows else []


def joint_error_table(result: Mapping[str, Any]) -> list[Table]:
    """Errors of predictions in degrees or millimetres, and the same in units of what noise makes."""
    found = [row for row in joint_rows(result) if row.get("noise")]
    if not found:
        return []
    names = {
        "before": "believed",
        "after": "mended",
        "constant_velocity": "constant velocity",
        "noise": "noise",
        "time_step": "time step",
        "floor": "both",
    }
    keys = [key for key in names if all(row.get(key) is not None for row in found)]
    models = [key for key in keys if key in ("before", "after")]
    rows = []
    for row in found:
        errors = [format_number(float(in_reading_unit(float(row[key]), row["unit"])[0])) for key in keys]
        ratios = [misfit_in_words(times_noise(row, key)) for key in models]
        rows.append([row["joint"], *errors, reading_unit(row["unit"]), *ratios])
    columns = ["joint", *(names[key] for key in keys), "unit", *(f"misfit {names[key]}" for key in models)]
    ahead = f"{found[0]['horizon']:g} s after a measured state"
    note = (
        f"Root mean square error of positions of held-out recordings, {ahead}, and what noise alone, the time step "
        f"alone, and both make of it. Misfit: the error in units of both ({SCALE})."
    )
    return [Table(columns, rows, note)]


def reading_unit(unit: str) -> str:
    """Unit in which a reader sees an error of positions."""
    return str(in_reading_unit(0.0, unit)[1])


def disagreement_tables(folder: Path) -> list[Table]:
    """The force that is missing by part and regime, before and after."""
    if not (folder / "disagreement.npz").is_file():
        return []
    data = read_arrays(folder / "disagreement.npz")
    note = (
        "Root mean square of the force that would make the {} model follow the recordings that were fitted; – marks a "
        "regime without data."
    )
    return [
        Table(
            ["part", *map(str, data["columns"]), "unit"],
            [
                (str(part), *map(format_number, row), str(unit))
                for part, row, unit in zip(data["rows"], data[key], data["units"], strict=True)
            ],
            note.format(model),
        )
        for key, model in (("before", "believed"), ("after", "mended"))
        if key in data
    ]


def change_table(changes: Sequence[Mapping[str, Any]], more: str) -> list[Table]:
    """Numbers that the mended model has instead of those of the believed one."""
    rows = []
    for one in changes:
        change = "new" if one["percent"] is None else f"{format_number(one['percent'])} %"
        values = [format_number(one[key]) for key in ("believed", "mended")]
        rows.append([one["what"], *values, unit_in_words(one["unit"]), change])
    return [Table(["number", "believed", "mended", "unit", "change"], rows, more)] if rows else []


def candidate_sections(result: Mapping[str, Any]) -> list[Section]:
    """The ranking, and what these data cannot distinguish."""
    ranking, given, effects = (result.get(key) or [] for key in ("ranking", "equivalent", "effects"))
    if not ranking:
        return []
    rows, found = [], {(one["effect"], one["location"]) for one in effects}
    alone = [row for row in ranking if not row.get("beside")]
    top = max((as_float(row["score"]) or 0.0 for row in alone), default=0.0)
    for many in hypotheses_of(ranking):
        row = many[0]
        is_named = any((one["effect"], one["location"]) in found for one in many)
        word = "named" if is_named else "alike" if row.get("equivalent") else ""
        beside = hypothesis_in_words(" + ".join(row.get("beside") or []))
        places = dict.fromkeys(place_in_words(one["location"]) for one in many)
        titles = enumerated([effect_title(one["effect"]) for one in many])
        held_out = as_float(row.get("held_out"))
        share = score_in_words(row.get("score"), top)
        shown = None if held_out is None else score_in_words(held_out, top)
        rows.append([titles, ", ".join(places), share, shown, word, beside])
    names = ("effect", "place", "score [%]", "held-out gain [%]", "note", "beside")
    alike = "these data cannot distinguish it from the named one" if effects else REASON_NOT_NAMED
    note = (
        "Score: fall of χ² by the effect, less a price for its numbers, in per cent of the best one's. Effects in one "
        f"row were tried together and have one score. Alike: {alike}."
    )
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
