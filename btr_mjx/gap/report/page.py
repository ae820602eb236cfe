"""One self-contained HTML page about a diagnosis, drawn from its saved files only.

Files of a diagnosis folder, of which all but the first may be missing:

- result.json: verdict, effects, ranking, equivalent, gap, next_experiment and other entries that the page shows;
- disagreement.npz: `rows` (R,), `columns` (C,), `before` (R, C) and optionally `after` (R, C) in units of the noise;
- overlays.npz: `recordings`, `names`, `units` (N,), for each n `time_n`, `measured_n`, `before_n`, `after_n` (K,);
- joint_forces.npz: `joints`, `units`, `follows` (J,), for each n `position_n`, `velocity_n`, `load_n`, `time_n`,
  `before_n`, `after_n`, `law_n`, `spread_n` (N,);
- sets.csv: numbers over sets of recordings, where there are several;
- next_command.csv: `time` and the proposed command;
- mended.json beside mended.xml; environment.json.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.report.content import content, is_json_number
from btr_mjx.gap.results import REASON_NOT_NAMED, effect_at_place, effect_title
from btr_mjx.pages import Figure, Table, embedded, write_page
from btr_mjx.plotting import style
from btr_mjx.runs import read_arrays, read_json, read_table, write_figure

if TYPE_CHECKING:
    from matplotlib import figure as drawn

_TEMPLATE = Path(__file__).with_name("report.html.j2")
_OVERLAYS = 6
"""Held-out stretches that the page shows, at most."""


def draw_report(folder: str | Path) -> Path:
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
    with style():
        pictures = _pictures(folder, result)
    values = content(folder, result)
    head = {"name": values["dataset"], "numbers": values["gap"], "candidates": _candidates(result)}
    return write_page(folder, _TEMPLATE, head | values | pictures)


def _candidates(result: Mapping[str, Any]) -> Table:
    """All candidates of the ranking."""
    rows = [
        [
            *(effect_title(row["effect"]), row["location"], row.get("score"), row.get("margin"), row.get("held_out")),
            ", ".join(_beside(row)) if row.get("beside") else "",
        ]
        for row in result.get("ranking") or []
    ]
    return Table(
        ["effect", "place", "score", "behind the first", "held-out gain", "beside"],
        rows,
        "Score: fall of the misfit (χ²), less a price for the effect's parameters.",
    )


def _pictures(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """The figures, each saved beside the page and inside it."""
    from btr_mjx.gap.report import figures

    out: dict[str, Any] = {
        "map": None,
        "ranking": [],
        "overlays": [],
        "command": None,
        "over_sets": None,
        "forces": None,
    }
    if (folder / "sets.csv").is_file():
        rows = read_table(folder / "sets.csv").to_dicts()
        figure = figures.numbers_over_sets(rows)
        caption = "Named numbers of each set, the oldest first, beside the believed model; bars are 90 % intervals."
        out["over_sets"] = _picture(folder, "sets", figure, "Numbers over the sets of recordings", caption)
    if (folder / "disagreement.npz").is_file():
        data = read_arrays(folder / "disagreement.npz")
        figure = figures.disagreement_map(
            _texts(data["rows"]), _texts(data["columns"]), data["before"], data.get("after")
        )
        caption = (
            "Mean square of the force that would make the believed model follow the data, in units of the value that "
            "noise alone would give: 1 is the noise floor, a dot marks a regime without data."
        )
        out["map"] = _picture(folder, "disagreement", figure, "Disagreement by part and regime", caption)
    found = [(e["effect"], e["location"]) for e in result.get("effects") or []]
    rows = list(result.get("ranking") or [])
    ranking = [row for row in rows if not row.get("beside")]
    if ranking:
        threshold = result["threshold"] if is_json_number(result.get("threshold")) else None
        figure = figures.ranking_bars(ranking, found, threshold)
        hatched = "these data cannot distinguish it from the named one" if found else REASON_NOT_NAMED
        caption = (
            "Score: fall of the misfit, less a price for the effect's parameters. Black: named. "
            f"Hatched: {hatched}. Grey: other candidates. Dotted line: score that a name needs at least."
        )
        if len(found) == 1 and any(row["score"] > ranking[0]["score"] for row in ranking):
            caption += (
                " What scores more than the name does not meet the other conditions for a name: it gains too little on "
                "held-out recordings, or errors of calibration explain as much."
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
            figures.OverlayData(
                recording, name, unit, *(data[f"{key}_{n}"] for key in ("time", "measured", "before", "after"))
            )
            for n, (recording, name, unit) in enumerate(
                zip(*(_texts(data[key]) for key in ("recordings", "names", "units")), strict=True)
            )
        ]
        if stretches:
            is_mended = result.get("verdict") != "unexplained"
            after: str | None = "mended model" if is_mended else "best candidate"
            if all(np.array_equal(one.before, one.after) for one in stretches):
                after = None  # there is no second model
            where = "the believed model is worst" if after is None else "the two models differ most"
            caption = f"Held-out stretches in which {where}. Left: coordinates. Right: model minus measured."
            figure = figures.overlay_figure(stretches[:_OVERLAYS], after)
            out["overlays"].append(_picture(folder, "overlays", figure, "Before and after", caption))
    if (folder / "joint_forces.npz").is_file():
        data = read_arrays(folder / "joint_forces.npz")
        joints = [
            figures.ForceData(
                joint,
                unit,
                {key: data[f"{key}_{n}"] for key in ("position", "velocity", "load", "time")},
                follows=follows.split(),
                **{key: data[f"{key}_{n}"] for key in ("before", "after", "law", "spread")},
            )
            for n, (joint, unit, follows) in enumerate(
                zip(*(_texts(data[key]) for key in ("joints", "units", "follows")), strict=True)
            )
        ]
        is_mended = bool(result.get("effects"))
        caption = "Force that the believed model lacks along the recordings that were fitted"
        caption += ", and force that is left beside the mended model" if is_mended else ""
        caption += "; orange: the law that was named, with its 90 % band." if any(j.law.any() for j in joints) else "."
        if joints:
            figure = figures.force_figure(joints, is_mended)
            out["forces"] = _picture(folder, "joint-forces", figure, "Missing force at joints", caption)
    if (folder / "next_command.csv").is_file():
        table = read_table(folder / "next_command.csv")
        names = [name for name in table.columns if name != "time"]
        figure = figures.commands(table["time"].to_numpy(), table.select(names).to_numpy(), names)
        more = len(names) - 5
        caption = "The proposed command" + (f"; {more} further channels are in next_command.csv." if more > 0 else ".")
        out["command"] = _picture(folder, "next-command", figure, "The proposed command", caption)
    return out


def _beside(row: Mapping[str, Any]) -> list[str]:
    return [
        effect_at_place(dict(zip(("effect", "location"), name.split("@", 1), strict=True))) for name in row["beside"]
    ]


def _picture(folder: Path, name: str, figure: "drawn.Figure", alt: str, caption: str) -> Figure:
    file = folder / "figures" / f"{name}.png"
    write_figure(file, figure, dpi=160)
    return embedded(file, alt, caption)


def _texts(values: np.ndarray) -> list[str]:
    return [str(value) for value in values]
