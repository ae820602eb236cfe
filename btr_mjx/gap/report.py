"""SHOW: one self-contained HTML page about a diagnosis, drawn from its saved files only.

    python -m btr_mjx.gap.report runs/diagnosis-0

Files of a diagnosis folder, of which all but the first may be missing:

- result.json: verdict, effects, ranking, equivalent, gap, next_experiment and what else the page shows;
- disagreement.npz: `rows` (R,), `columns` (C,), `before` (R, C) and optionally `after` (R, C) in units of the noise;
- overlays.npz: `recordings`, `names`, `units` (N,), for each n `time_n`, `measured_n`, `before_n`, `after_n` (K,);
- next_command.csv: `time` and the proposed command;
- mended.json beside mended.xml; environment.json.
"""

import base64
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.files import atomic_write, read_arrays, read_json, read_table, write_figure
from btr_mjx.gap.wording import named, number, title, verdict_sentence
from btr_mjx.plots import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = "report.html"
_TEMPLATE = Path(__file__).with_name("report.html.j2")
_OVERLAYS = 6

_CODE = """import json, mujoco
from btr_mjx.gap.mend import Callback

model = mujoco.MjModel.from_xml_path("mended.xml")
data = mujoco.MjData(model)
missing = Callback(model, json.load(open("mended.json"))["terms"])
while data.time < 1.0:
    data.ctrl[:] = controller(data.time)
    missing(model, data)  # before every step
    mujoco.mj_step(model, data)"""


def draw(folder: str | Path) -> Path:
    """Draw the page and its figures from a diagnosis folder.

    Args:
      folder: where the diagnosis saved its files; report.html and figures/*.png are written there.

    Returns:
      The page.

    Raises:
      InputError: the folder holds no diagnosis.
      OSError: it cannot be written to.
    """
    folder = Path(folder)
    if not (folder / "result.json").is_file():
        raise InputError(f"{folder}: no result.json there; expected the folder of a diagnosis")
    result = read_json(folder / "result.json")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    with style():
        pictures = _pictures(folder, result)
    html = environment.from_string(_TEMPLATE.read_text(encoding="utf-8")).render(_content(folder, result) | pictures)
    with atomic_write(folder / PAGE) as file:
        file.write(html.encode("utf-8"))
    return folder / PAGE


def _pictures(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """The figures, each saved beside the page and inside it."""
    from btr_mjx.gap import report_figures as figures

    out: dict[str, Any] = {"map": None, "ranking": [], "overlays": [], "command": None}
    if (folder / "disagreement.npz").is_file():
        data = read_arrays(folder / "disagreement.npz")
        figure = figures.disagreement_map(
            _texts(data["rows"]), _texts(data["columns"]), data["before"], data.get("after")
        )
        caption = (
            "Mean square of the force that would make the believed model follow the data, in units of what noise alone "
            "would give: 1 is the noise floor, a dot a regime without data."
        )
        out["map"] = _picture(folder, "disagreement", figure, "Disagreement by part and regime", caption)
    found = [(e["effect"], e["location"]) for e in result.get("effects") or []]
    rows = list(result.get("ranking") or [])
    ranking = [row for row in rows if not row.get("beside")]
    if ranking:
        threshold = result["threshold"] if _is_number(result.get("threshold")) else None
        figure = figures.ranking_bars(ranking, found, threshold)
        caption = (
            "Score: how far the misfit falls, beyond what the effect's numbers cost. Black: named. Hatched: cannot be "
            "told apart from it by these data. Grey: other candidates. Dotted line: what a name needs at least."
        )
        out["ranking"].append(_picture(folder, "ranking", figure, "Candidates by score", caption))
    second = [row for row in rows if row.get("beside")]
    if second and len(found) > 1:
        figure = figures.ranking_bars(second, found)
        caption = (
            f"The same for one more effect beside {' and '.join(_beside(second[0]))}; scores are of both together."
        )
        out["ranking"].append(_picture(folder, "ranking-second", figure, "Candidates for one more effect", caption))
    if (folder / "overlays.npz").is_file():
        data = read_arrays(folder / "overlays.npz")
        stretches = [
            figures.Stretch(
                recording, name, unit, *(data[f"{key}_{n}"] for key in ("time", "measured", "before", "after"))
            )
            for n, (recording, name, unit) in enumerate(
                zip(*(_texts(data[key]) for key in ("recordings", "names", "units")), strict=True)
            )
        ]
        if stretches:
            caption = "Held-out stretches in which the believed model is worst, with what is left of the difference."
            after = {"effect": "mended model", "unexplained": "best candidate"}.get(str(result.get("verdict")))
            figure = figures.overlays(stretches[:_OVERLAYS], after)
            out["overlays"].append(_picture(folder, "overlays", figure, "Before and after", caption))
    if (folder / "next_command.csv").is_file():
        table = read_table(folder / "next_command.csv")
        names = [name for name in table.columns if name != "time"]
        figure = figures.commands(table["time"].to_numpy(), table.select(names).to_numpy(), names)
        more = len(names) - 5
        caption = "The proposed command" + (f"; {more} further channels are in next_command.csv." if more > 0 else ".")
        out["command"] = _picture(folder, "next-command", figure, "The proposed command", caption)
    return out


def _beside(row: Mapping[str, Any]) -> list[str]:
    return [named(dict(zip(("effect", "location"), name.split("@", 1), strict=True))) for name in row["beside"]]


def _picture(folder: Path, name: str, figure: "Figure", alt: str, caption: str) -> dict[str, str]:
    file = folder / "figures" / f"{name}.png"
    write_figure(file, figure, dpi=160)
    return {"data": base64.b64encode(file.read_bytes()).decode("ascii"), "alt": alt, "caption": caption}


def _texts(values: np.ndarray) -> list[str]:
    return [str(value) for value in values]


def _content(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """Everything on the page but the figures."""
    effects = [
        {
            "effect": title(effect["effect"]),
            "location": effect["location"],
            "name": name.replace("_", " "),
            **{key: number(parameter.get(key)) for key in ("value", "low", "high")},
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
        "mended": _mended(folder),
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
    return [(label, f"{number(gap[key])}{of}") for label, key, of in rows if _is_number(gap.get(key))]


def _is_number(value: Any) -> bool:
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
    cells = [[number(v) if _is_number(v) else str("" if v is None else v) for v in row.values()] for row in rows]
    return {"columns": [name.replace("_", " ") for name in columns], "rows": cells}


def _mended(folder: Path) -> dict[str, Any] | None:
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
        native = [
            named(dict(zip(("effect", "location"), n.split("@", 1), strict=True))) for n in saved.get("native", [])
        ]
        text += f" It contains {' and '.join(native)}." if native else ""
        text += " ".join(["", *saved.get("notes", [])])
    if terms:
        text += " What MJCF has no term for is in mended.json; this adds it to a simulation:"
    return {"text": text, "terms": terms, "code": _CODE}


def _footer(folder: Path, result: Mapping[str, Any]) -> list[str]:
    lines = []
    spent = []
    if _is_number(result.get("steps")):
        spent.append(f"{int(result['steps']):,} simulated steps".replace(",", " "))
    if _is_number(result.get("seconds")):
        spent.append(f"{number(result['seconds'])} s")
    if _is_number(result.get("seed")):
        spent.append(f"seed {int(result['seed'])}")
    if spent:
        lines.append(", ".join(spent))
    if (folder / "environment.json").is_file():
        lines.append(
            _said({k: v for k, v in read_json(folder / "environment.json").items() if v not in (None, [], {})})
        )
    lines.append("Numbers: result.json. Figures: figures/. Tables: *.csv, *.npz.")
    return lines


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    import tyro

    def command(folders: Annotated[tuple[Path, ...], tyro.conf.Positional]) -> tuple[Path, ...]:
        """Draw the pages of diagnoses again.

        Args:
          folders: folders of btr_mjx.diagnose.
        """
        return folders

    folders = tyro.cli(command, args=sys.argv[1:] if argv is None else list(argv), prog="btr_mjx.gap.report")
    with cli_errors():
        for folder in folders:
            print(draw(folder))


if __name__ == "__main__":
    main()
