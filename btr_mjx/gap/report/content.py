"""Text and tables of the page about a diagnosis, from its saved files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER
from btr_mjx.gap.results import (
    REASON_NOT_NAMED,
    detail_sentences,
    effect_at_place,
    effect_title,
    estimate_cells,
    format_number,
    in_percent,
    parameter_in_words,
    parameters_in_words,
    place_in_words,
    unit_in_words,
    verdict_sentence,
)
from btr_mjx.runs import read_json, read_table

_CODE = """import json, mujoco
from btr_mjx.gap.results import Callback

model = mujoco.MjModel.from_xml_path("mended.xml")
data = mujoco.MjData(model)
missing = Callback(model, json.load(open("mended.json"))["terms"])
while data.time < 1.0:
    data.ctrl[:] = controller(data.time)
    missing(model, data)  # before every step
    mujoco.mj_step(model, data)"""


_BETWEEN = {
    "hold": "Commands were held from one sample to the next, as a loop that sets data.ctrl at each sample does.",
    "linear": "Between samples, commands were taken as straight lines: before each step, set data.ctrl to their value "
    "at data.time.",
    "cubic": "Between samples, commands were taken as a cubic spline: before each step, set data.ctrl to its value at "
    "data.time.",
}


def content(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """Everything on the page but the figures.

    Args:
      folder: of the diagnosis.
      result: content of its result.json.

    Returns:
      Variables of the page's template.
    """
    effects = [
        {
            "effect": effect_title(effect["effect"]),
            "location": place_in_words(str(effect["location"]).removeprefix(EACH_MEMBER)),
            "name": parameter_in_words(name),
            **estimate_cells(parameter),
            "unit": unit_in_words(parameter.get("unit")),
        }
        for effect in result.get("effects") or []
        for name, given in effect["parameters"].items()
        for parameter in [in_percent(name, given)]
    ]
    return {
        "heading": "What has changed" if result.get("before") else "Simulation against data",
        "before": _before(result.get("before")),
        "sets": _sets(folder),
        "dataset": str(result.get("dataset") or folder.name),
        "sentence": verdict_sentence(result),
        "details": detail_sentences(result),
        "gap": _gap(result.get("gap") or {}, bool(effects)),
        "effects": effects,
        "interval_note": str(
            result.get("interval_note") or "From, to: 90 % interval; it does not assume that the fit is good."
        ),
        "laws": [
            f"{place_in_words(str(effect['location']))}: {effect['equation']}"
            for effect in result.get("effects") or []
            if effect.get("latex")
        ],
        "unexplained": _lines(result.get("unexplained")),
        "equivalent": _equivalent(result),
        "reason_not_named": REASON_NOT_NAMED,
        "believed": _table(result.get("believed")),
        "confounds": _lines(result.get("confounds")),
        "next_experiment": _experiment(result.get("next_experiment")),
        "mended": _mended(folder, result),
        "notes": _lines(result.get("notes")),
        "preflight": _preflight(folder),
        "footer": _footer(result),
    }


def _before(before: Any) -> dict[str, Any] | None:
    """What the diagnosis of the recordings before said."""
    if not before:
        return None
    found = [f"{effect_at_place(e)} ({parameters_in_words(e)})" for e in before.get("effects") or []]
    return {"dataset": before["dataset"], "sentence": before["sentence"], "effects": found}


def _sets(folder: Path) -> dict[str, Any] | None:
    """Numbers over sets of recordings."""
    if not (folder / "sets.csv").is_file():
        return None
    rows = read_table(folder / "sets.csv").to_dicts()
    shown = [
        {
            "set": row["name"],
            "number": f"{effect_at_place(row)}, {parameter_in_words(row['parameter'])}",
            "value": row["value"],
            "from": row["low"],
            "to": row["high"],
            "unit": unit_in_words(row["unit"]),
            "named": "yes" if row["named"] else "",
        }
        for row in rows
    ]
    return _table(shown)


def _preflight(folder: Path) -> dict[str, list[str]] | None:
    """What was odd about the data before the search: warnings, and notes."""
    if not (folder / "preflight.csv").is_file():
        return None
    rows = read_table(folder / "preflight.csv").select("level", "message").rows()
    return {
        "warnings": [str(message) for level, message in rows if level != "note"],
        "notes": [str(message) for level, message in rows if level == "note"],
    }


def _gap(gap: Mapping[str, Any], mended: bool) -> list[tuple[str, str]]:
    """Figures under the verdict."""
    loop = f" {gap.get('open_loop_unit', 'rad')}"
    unit = f" [{gap['unit']}]" if gap.get("unit") else ""
    chi2 = str(gap.get("unit") or "").startswith("χ²")
    held_out = "held-out misfit (1 = noise)" if chi2 else "held-out gap"
    rows = (
        (f"open-loop error{' before' if mended else ''}", "open_loop_before", loop),
        ("after", "open_loop_after" if mended else "", loop),
        ("noise alone", "open_loop_noise" if is_json_number(gap.get("open_loop_before")) else "", loop),
        (f"{held_out}{' before' if mended else ''}{'' if chi2 else unit}", "before", ""),
        ("after", "after" if mended else "", ""),
        ("noise floor", "noise_floor", ""),
    )
    return [(label, f"{format_number(gap[key])}{of}") for label, key, of in rows if is_json_number(gap.get(key))]


def is_json_number(value: Any) -> bool:
    """Whether a value of result.json is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _lines(value: Any) -> list[str]:
    """A text, a mapping or a list as lines of text."""
    if value in (None, "", [], {}):
        return []
    if isinstance(value, str):
        return [value]
    if isinstance(value, Mapping):
        if isinstance(value.get("text"), str):
            return [value["text"]]
        return [
            f"{str(key).replace('_', ' ')}: {_in_words(item)}" for key, item in value.items() if item not in (None, [])
        ]
    if isinstance(value, Sequence):
        return [line for item in value for line in ([_in_words(item)] if isinstance(item, Mapping) else _lines(item))]
    return [_in_words(value)]


def _experiment(value: Any) -> list[str]:
    """The next experiment, and the two candidates that it separates."""
    lines = _lines(value)
    if isinstance(value, Mapping) and len(value.get("between") or []) == 2:
        pair = [effect_at_place(one) if "effect" in one else str(one["name"]) for one in value["between"]]
        lines.append(f"It decides between {pair[0]} and {pair[1]}.")
    return lines


def _in_words(value: Any) -> str:
    """One value of result.json as text."""
    if isinstance(value, Mapping):
        if isinstance(value.get("text"), str):
            return value["text"]
        if "effect" in value and "location" in value:
            rest = {k: v for k, v in value.items() if k not in ("effect", "location", "parameters", "values")}
            more = ", ".join(f"{str(k).replace('_', ' ')} {_in_words(v)}" for k, v in rest.items())
            return effect_at_place(value) + (f" ({more})" if more else "")
        return ", ".join(f"{str(key).replace('_', ' ')} {_in_words(item)}" for key, item in value.items())
    if isinstance(value, bool) or value is None:
        return "no" if not value else "yes"
    if isinstance(value, int | float):
        return format_number(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        shown = [_in_words(item) for item in value[:12]]
        return ", ".join(shown) + (", …" if len(value) > 12 else "")
    return str(value)


def _equivalent(result: Mapping[str, Any]) -> list[str]:
    """Equivalent candidates, where there are more than the named effects."""
    given = result.get("equivalent") or []
    out = []
    for entry in given if len(given) > 1 or not result.get("effects") else []:
        members = entry if isinstance(entry, Sequence) and not isinstance(entry, str) else [entry]
        out.append(
            "; ".join(effect_at_place(m) if isinstance(m, Mapping) and "effect" in m else _in_words(m) for m in members)
        )
    return out


def _table(rows: Any) -> dict[str, Any] | None:
    """A list of mappings as a table; the first column is the name."""
    if not isinstance(rows, Sequence) or isinstance(rows, str) or not rows:
        return None
    columns = list(rows[0])
    cells = [
        [format_number(v) if is_json_number(v) else str("" if v is None else v) for v in row.values()] for row in rows
    ]
    return {"columns": [name.replace("_", " ") for name in columns], "rows": cells}


def _cell(value: Any) -> str:
    return format_number(value) if is_json_number(value) else str("" if value is None else value)


def _mended(folder: Path, result: Mapping[str, Any]) -> dict[str, Any] | None:
    if not (folder / "mended.xml").is_file():
        return None
    path = folder / "mended.xml"
    text = f"{path} is the believed model with what was found; plain MuJoCo loads it."
    between = _BETWEEN.get(str(result.get("interpolation")), "")
    load = f'model = mujoco.MjModel.from_xml_path("{path}")'
    changes: list[dict[str, str]] = []
    terms: list[dict[str, str]] = []
    if (folder / "mended.json").is_file():
        saved = read_json(folder / "mended.json")
        terms = [
            {
                "effect": effect_title(t["effect"]),
                "location": place_in_words(t["location"]),
                "equation": str(t.get("equation", "")),
            }
            for t in saved.get("terms", [])
        ]
        names = dict.fromkeys(f"{e['effect']}@{e['location']}" for e in result.get("effects") or [])
        native = [
            effect_at_place(dict(zip(("effect", "location"), name.split("@", 1), strict=True)))
            for name in saved.get("native", [])
            if name in names
        ]
        native += ["calibration"] if result.get("calibration") else []
        text += f" It contains {' and '.join(native)}." if native else ""
        changes = [
            {
                "part": str(c["part"]),
                "field": str(c["field"]),
                "believed": _cell(c["believed"]),
                "mended": _cell(c["mended"]),
            }
            for c in saved.get("changes", [])
        ]
        text += " ".join(["", *saved.get("notes", [])])
    if terms:
        text += " Effects without a term in MJCF are in mended.json; this code adds them to a simulation:"
    ranges = (folder / "randomisation.json").is_file()
    return {"text": text, "terms": terms, "code": _CODE, "load": load, "changes": changes} | {
        "between": between,
        "ranges": ranges,
    }


def _footer(result: Mapping[str, Any]) -> list[str]:
    lines = []
    spent = []
    if is_json_number(result.get("steps")):
        spent.append(f"{int(result['steps']):,} simulated steps".replace(",", " "))
    if is_json_number(result.get("seconds")):
        spent.append(f"{format_number(result['seconds'])} s")
    if is_json_number(result.get("seed")):
        spent.append(f"seed {int(result['seed'])}")
    if spent:
        lines.append(", ".join(spent))
    lines.append("Numbers: result.json. Figures: figures/. Tables: *.csv, *.npz.")
    return lines
