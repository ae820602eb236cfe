"""The words and tables of the page about a diagnosis, from its saved files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.gap.results import named, number, title, verdict_sentence, with_ends
from btr_mjx.runs import read_json

_CODE = """import json, mujoco
from btr_mjx.gap.mend import Callback

model = mujoco.MjModel.from_xml_path("mended.xml")
data = mujoco.MjData(model)
missing = Callback(model, json.load(open("mended.json"))["terms"])
while data.time < 1.0:
    data.ctrl[:] = controller(data.time)
    missing(model, data)  # before every step
    mujoco.mj_step(model, data)"""


def content(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """Everything on the page but the figures.

    Args:
      folder: of the diagnosis.
      result: what its result.json says.

    Returns:
      Variables of the page's template.
    """
    effects = [
        {
            "effect": title(effect["effect"]),
            "location": effect["location"],
            "name": name.replace("_", " "),
            **with_ends(parameter),
            "unit": _unit(parameter.get("unit")),
        }
        for effect in result.get("effects") or []
        for name, parameter in effect["parameters"].items()
    ]
    return {
        "heading": "Simulation against data",
        "dataset": str(result.get("dataset") or folder.name),
        "sentence": verdict_sentence(result),
        "gap": _gap(result.get("gap") or {}, bool(effects)),
        "effects": effects,
        "interval_note": str(
            result.get("interval_note")
            or "From and to: 90 % intervals from resampled windows, which do not assume that the fit is good."
        ),
        "unexplained": _lines(result.get("unexplained")),
        "equivalent": _equivalent(result),
        "believed": _table(result.get("believed")),
        "confounds": _lines(result.get("confounds")),
        "next_experiment": _experiment(result.get("next_experiment")),
        "mended": _mended(folder, result.get("calibration") or []),
        "notes": _lines(result.get("notes")),
        "footer": _footer(folder, result),
    }


def _unit(unit: Any) -> str:
    return "" if unit in (None, "1") else str(unit)


def _gap(gap: Mapping[str, Any], mended: bool) -> list[tuple[str, str]]:
    """Figures under the verdict."""
    loop = f" {gap.get('open_loop_unit', 'rad')}"
    unit = f" [{gap['unit']}]" if gap.get("unit") else ""
    rows = (
        (f"open-loop error{' before' if mended else ''}", "open_loop_before", loop),
        ("after", "open_loop_after" if mended else "", loop),
        (f"held-out gap{' before' if mended else ''}{unit}", "before", ""),
        ("after", "after" if mended else "", ""),
        ("noise floor", "noise_floor", ""),
    )
    return [(label, f"{number(gap[key])}{of}") for label, key, of in rows if is_json_number(gap.get(key))]


def is_json_number(value: Any) -> bool:
    """Whether a value of result.json is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _lines(value: Any) -> list[str]:
    """Whatever is to be listed, as lines of text."""
    if value in (None, "", [], {}):
        return []
    if isinstance(value, str):
        return [value]
    if isinstance(value, Mapping):
        if isinstance(value.get("text"), str):
            return [value["text"]]
        return [f"{str(key).replace('_', ' ')}: {_said(item)}" for key, item in value.items() if item not in (None, [])]
    if isinstance(value, Sequence):
        return [line for item in value for line in ([_said(item)] if isinstance(item, Mapping) else _lines(item))]
    return [_said(value)]


def _experiment(value: Any) -> list[str]:
    """What to do next, and between which candidates it decides."""
    lines = _lines(value)
    if isinstance(value, Mapping) and len(value.get("between") or []) == 2:
        pair = [named(one) if "effect" in one else str(one["name"]) for one in value["between"]]
        lines.append(f"It decides between {pair[0]} and {pair[1]}.")
    return lines


def _said(value: Any) -> str:
    """One item in words."""
    if isinstance(value, Mapping):
        if isinstance(value.get("text"), str):
            return value["text"]
        if "effect" in value and "location" in value:
            rest = {k: v for k, v in value.items() if k not in ("effect", "location", "parameters", "values")}
            more = ", ".join(f"{str(k).replace('_', ' ')} {_said(v)}" for k, v in rest.items())
            return named(value) + (f" ({more})" if more else "")
        return ", ".join(f"{str(key).replace('_', ' ')} {_said(item)}" for key, item in value.items())
    if isinstance(value, bool) or value is None:
        return "no" if not value else "yes"
    if isinstance(value, int | float):
        return number(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        shown = [_said(item) for item in value[:12]]
        return ", ".join(shown) + (", …" if len(value) > 12 else "")
    return str(value)


def _equivalent(result: Mapping[str, Any]) -> list[str]:
    """What cannot be told apart, if that is more than what was named."""
    given = result.get("equivalent") or []
    out = []
    for entry in given if len(given) > 1 or not result.get("effects") else []:
        members = entry if isinstance(entry, Sequence) and not isinstance(entry, str) else [entry]
        out.append("; ".join(named(m) if isinstance(m, Mapping) and "effect" in m else _said(m) for m in members))
    return out


def _table(rows: Any) -> dict[str, Any] | None:
    """A list of mappings as a table; the first column is the name."""
    if not isinstance(rows, Sequence) or isinstance(rows, str) or not rows:
        return None
    columns = list(rows[0])
    cells = [[number(v) if is_json_number(v) else str("" if v is None else v) for v in row.values()] for row in rows]
    return {"columns": [name.replace("_", " ") for name in columns], "rows": cells}


def _mended(folder: Path, calibration: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    if not (folder / "mended.xml").is_file():
        return None
    text = "mended.xml is the believed model with what was found; plain MuJoCo loads it."
    terms: list[dict[str, str]] = []
    if (folder / "mended.json").is_file():
        saved = read_json(folder / "mended.json")
        terms = [
            {"effect": title(t["effect"]), "location": t["location"], "equation": str(t.get("equation", ""))}
            for t in saved.get("terms", [])
        ]
        errors = {f"{error['effect']}@{error['location']}" for error in calibration}
        native = [
            named(dict(zip(("effect", "location"), name.split("@", 1), strict=True)))
            for name in saved.get("native", [])
            if name not in errors
        ]
        text += f" It contains {' and '.join(native)}." if native else ""
        if calibration:
            text += f" It has small errors of calibration, too, beside which that was found: {_errors(calibration)}."
        text += " ".join(["", *saved.get("notes", [])])
    if terms:
        text += " What MJCF has no term for is in mended.json; this adds it to a simulation:"
    return {"text": text, "terms": terms, "code": _CODE}


def _errors(calibration: Sequence[Mapping[str, Any]]) -> str:
    """Errors of calibration with their numbers."""
    return "; ".join(
        f"{named(error)} ({', '.join(f'{k.replace("_", " ")} {number(v)}' for k, v in error['parameters'].items())})"
        for error in calibration
    )


def _footer(folder: Path, result: Mapping[str, Any]) -> list[str]:
    lines = []
    spent = []
    if is_json_number(result.get("steps")):
        spent.append(f"{int(result['steps']):,} simulated steps".replace(",", " "))
    if is_json_number(result.get("seconds")):
        spent.append(f"{number(result['seconds'])} s")
    if is_json_number(result.get("seed")):
        spent.append(f"seed {int(result['seed'])}")
    if spent:
        lines.append(", ".join(spent))
    if (folder / "environment.json").is_file():
        lines.append(
            _said({k: v for k, v in read_json(folder / "environment.json").items() if v not in (None, [], {})})
        )
    lines.append("Numbers: result.json. Figures: figures/. Tables: *.csv, *.npz.")
    return lines
