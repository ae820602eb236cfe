"""Sections of the page about a diagnosis, from its saved files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.gap.data import listed
from btr_mjx.gap.report.tables import (
    as_table,
    calibration_table,
    candidate_sections,
    change_table,
    disagreement_tables,
    effect_table,
    joint_error_table,
    reading_unit,
    table_over_sets,
)
from btr_mjx.gap.results import (
    Levels,
    as_float,
    detail_sentences,
    effect_at_place,
    effect_title,
    error_in_words,
    format_number,
    hypothesis_in_words,
    in_reading_unit,
    mended_in_words,
    misfit_in_words,
    parameters_in_words,
    place_in_words,
)
from btr_mjx.pages import Curves, Figure, Section, Table
from btr_mjx.runs import read_arrays, read_json, read_table

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

_STRETCHES, _SAMPLES = 6, 2000
"""Held-out stretches that the page shows, and samples of each, at most."""

_CHANGES = 20
"""Numbers of the mended model that the page lists, at most."""


def report_sections(folder: Path, result: Mapping[str, Any], figures: Mapping[str, Figure]) -> list[Section]:
    """Everything on the page below the verdict; figures are by the names of their files."""
    shown = lambda *names: [figures[name] for name in names if name in figures]  # noqa: E731
    effects, before = result.get("effects") or [], result.get("before")
    laws = [f"{place_in_words(str(e['location']))}: {e['equation']}" for e in effects if e.get("latex")]
    return [
        Section("", detail_sentences(result)),
        Section("What has changed" if before else "What is missing", tables=effect_table(result)),
        Section("Calibration that is off", tables=calibration_table(result)),
        Section("Before", _before(before) if before else []),
        Section("Numbers over the sets of recordings", figures=shown("sets"), tables=table_over_sets(folder)),
        Section("Errors of predictions by joint", tables=joint_error_table(result)),
        Section(
            f"{'Before and after, on recordings' if result.get('mended') else 'Recordings'} that were not fitted",
            **_overlays(folder, result),
        ),
        *_preflight(folder),
        Section("What the unexplained part looks like", _lines(result.get("unexplained"))),
        Section("Missing force", laws, shown("joint-forces")) if shown("joint-forces") else Section(""),
        Section("Where simulation and data disagree", tables=disagreement_tables(folder)),
        *candidate_sections(result),
        Section("Believed parameters", tables=as_table(result.get("believed") or [])),
        Section("What could be mistaken for it", _lines(result.get("confounds"))),
        Section("Next experiment", _experiment(result.get("next_experiment")), shown("next-command")),
        *_mended(folder, result),
        Section("Notes", _lines(result.get("notes"))),
    ]


def _before(before: Mapping[str, Any]) -> list[str]:
    """What the diagnosis of the recordings before said."""
    found = [f"{effect_at_place(e)} ({parameters_in_words(e)})" for e in before.get("effects") or []]
    return [f"{before['dataset']}: {before['sentence']}", *found]


def _overlays(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """Held-out stretches, measured and simulated."""
    data = read_arrays(folder / "overlays.npz") if (folder / "overlays.npz").is_file() else {}
    stretches = list(zip(*(data.get(key, ()) for key in ("recordings", "names", "units")), strict=True))[:_STRETCHES]
    if not stretches:
        return {}
    same = all(np.array_equal(data[f"before_{n}"], data[f"after_{n}"]) for n in range(len(stretches)))
    labels = {"measured": "measured", "before": "believed model"} | ({} if same else {"after": "mended model"})
    curves = []
    for n, (recording, name, unit) in enumerate(stretches):
        every = -(-len(data[f"time_{n}"]) // _SAMPLES)
        lines = {label: _plain(in_reading_unit(data[f"{key}_{n}"][::every], unit)[0]) for key, label in labels.items()}
        time = [round(float(t), 6) for t in data[f"time_{n}"][::every]]
        curves.append(Curves(f"{name}, recording {recording}", reading_unit(unit), time, lines))
    where = "the believed model is worst" if same else "the two models differ most"
    return {"lines": [f"Held-out stretches in which {where}."], "curves": curves}


def _plain(values: np.ndarray) -> list[float | None]:
    """Values for JSON, with six digits."""
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values]


def _between(interpolation: Mapping[str, str]) -> list[str]:
    """A sentence about the commands between samples for each interpolation, by names of recordings."""
    kinds = dict.fromkeys(interpolation.values())
    of = {kind: listed([name for name, own in interpolation.items() if own == kind]) for kind in kinds}
    return [_BETWEEN[kind] if len(kinds) == 1 else f"{of[kind]}: {_BETWEEN[kind]}" for kind in kinds]


def _preflight(folder: Path) -> list[Section]:
    """What was odd about the data before the search: warnings, and notes."""
    if not (folder / "preflight.csv").is_file():
        return []
    rows = read_table(folder / "preflight.csv").select("level", "message").rows()
    warnings = [str(message) for level, message in rows if level != "note"]
    notes = [str(message) for level, message in rows if level == "note"]
    nothing = "Nothing that matters was found before the search."
    return [
        Section("What is odd about the data", warnings or [nothing]),
        Section("All that was looked at", notes, folded=True),
    ]


def headline_numbers(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Figures under the verdict, as the sentences have them; a mean over radians and metres is none."""
    levels, loop = Levels.of(result), result.get("open_loop") or {}
    rows = []
    if levels.unit == "noise":
        many = (("misfit, believed model", levels.before), ("mended model", levels.after))
        rows += [(name, misfit_in_words(value)) for name, value in many if value is not None]
        rows += [("noise and time step", "1")]
    elif levels.before is not None:
        two = (("held-out Delta_fitness", levels.before), ("after", levels.after))
        rows += [(name, error_in_words(value, levels.unit)) for name, value in two if value is not None]
    if "and" not in str(loop.get("unit")):
        ends = [("open-loop error, believed model", "before"), ("mended model", "after")]
        known = [(name, as_float(loop.get(key))) for name, key in ends]
        rows += [(name, error_in_words(value, str(loop["unit"]))) for name, value in known if value is not None]
    return rows


def is_json_number(value: Any) -> bool:
    """Whether a value of result.json is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _lines(value: Any) -> list[str]:
    """A text, or a list of texts and of entries with a text."""
    if not value:
        return []
    many = [value] if isinstance(value, str | Mapping) else value
    return [str(one["text"]) if isinstance(one, Mapping) else str(one) for one in many]


def _experiment(value: Any) -> list[str]:
    """The next experiment, and the two candidates that it separates."""
    lines = _lines(value)
    if value and len(value.get("between") or []) == 2:
        pair = [effect_at_place(one) if "effect" in one else str(one["name"]) for one in value["between"]]
        lines.append(f"It decides between {pair[0]} and {pair[1]}.")
    return lines


def _mended(folder: Path, result: Mapping[str, Any]) -> list[Section]:
    """How to load the mended model, what is in it, and code for what MJCF cannot express."""
    if not (folder / "mended.xml").is_file():
        return []
    path = folder / "mended.xml"
    saved = read_json(folder / "mended.json") if (folder / "mended.json").is_file() else {}
    terms, changes = saved.get("terms", []), saved.get("changes", [])
    found = [*(result.get("effects") or []), *(result.get("unnamed") or [])]
    own = {f"{e['effect']}@{e['location']}" for e in found}
    inside = [hypothesis_in_words(name) for name in saved.get("native", []) if name in own]
    inside += ["calibration"] if result.get("calibration") else []
    lines = [
        f"{path} is {mended_in_words(result) or 'the believed model with what was found'}; plain MuJoCo loads it."
        + (f" It contains {' and '.join(inside)}." if inside else ""),
        *saved.get("notes", []),
        *_between(result.get("interpolation") or {}),
        "parameters.csv holds the values with their intervals"
        + (
            ", randomisation.json the ranges of the model's numbers"
            if (folder / "randomisation.json").is_file()
            else ""
        )
        + ". These intervals are statistical only: widen them for domain randomisation (docs/exports.md).",
        "Effects without a term in MJCF are in mended.json; the code below adds them to a simulation." if terms else "",
    ]
    more = f"And {len(changes) - _CHANGES} more, listed in mended.json." if len(changes) > _CHANGES else ""
    tables = change_table(changes[:_CHANGES], more)
    rows = [[effect_title(t["effect"]), place_in_words(t["location"]), t.get("equation", "")] for t in terms]
    tables += [Table(["effect without a term in MJCF", "place", "equation"], rows)] if rows else []
    code = _CODE if terms else f'model = mujoco.MjModel.from_xml_path("{path}")'
    return [Section("The mended model", [line for line in lines if line], tables=tables, code=code)]


def spent(result: Mapping[str, Any]) -> list[str]:
    """What the diagnosis took, in a line."""
    words = {"steps": "{:,} simulated steps", "seconds": "{} s", "seed": "seed {}"}
    found = {key: result[key] for key in words if is_json_number(result.get(key))}
    if "seconds" in found:
        found["seconds"] = format_number(found["seconds"])
    return [", ".join(words[key].format(value).replace(",", " ") for key, value in found.items())] if found else []
