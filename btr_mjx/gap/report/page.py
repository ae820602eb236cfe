"""One self-contained HTML page about a diagnosis, drawn from its saved files only.

Files of a diagnosis folder, of which all but the first may be missing:

- result.json: verdict, effects, ranking, equivalent, misfit, joint_errors, next_experiment and other entries;
- disagreement.npz: `rows` (R,), `units` (R,), `columns` (C,), `before` (R, C) and optionally `after` (R, C) [N or N m];
- overlays.npz: `recordings`, `names`, `units` (N,), for each n `time_n`, `measured_n`, `before_n`, `after_n` (K,);
- joint_forces.npz: `joints`, `units`, `follows` (J,), for each n `position_n`, `velocity_n`, `load_n`, `time_n`,
  `before_n`, `after_n`, `law_n`, `spread_n` (N,);
- sets.csv: numbers over sets of recordings, where there are several;
- next_command.csv: `time` and the proposed command;
- mended.json beside mended.xml; environment.json.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from btr_mjx.errors import InputError
from btr_mjx.gap.report.content import headline_numbers, report_sections, spent
from btr_mjx.gap.results import verdict_sentence
from btr_mjx.pages import Figure, embedded, write_page
from btr_mjx.plotting import save_figure
from btr_mjx.runs import read_arrays, read_json, read_table

if TYPE_CHECKING:
    from matplotlib import figure as drawn


def draw_report(folder: str | Path) -> Path:
    """Draw the page and its figures from a diagnosis folder.

    Args:
      folder: where the diagnosis saved its files; report.html and figures/*.png are written there.

    Returns:
      The page; figures that fail are left out, which one line each on stderr says.

    Raises:
      InputError: the folder holds no diagnosis, or one of an earlier version.
      OSError: it cannot be written to.
    """
    folder = Path(folder)
    if not (folder / "result.json").is_file():
        raise InputError(f"{folder}: no result.json there; expected the folder of a diagnosis")
    result = read_json(folder / "result.json")
    if "misfit" not in result:
        raise InputError(f"{folder}: its result.json has no `misfit`: it is of an earlier version; diagnose again")
    variables = {
        "heading": "What has changed" if result.get("before") else "Simulation against data",
        "name": str(result.get("dataset") or folder.name),
        "sentence": verdict_sentence(result),
        "numbers": headline_numbers(result),
        "sections": report_sections(folder, result, _figures(folder, result)),
        "footer": [*spent(result), "Numbers: result.json. Figures: figures/. Tables: *.csv, *.npz."],
    }
    return write_page(folder, variables)


def _figures(folder: Path, result: Mapping[str, Any]) -> dict[str, Figure]:
    """The figures by name, each saved beside the page and inside it."""
    out: dict[str, Figure] = {}
    for name, (make, alt, caption) in _wanted(folder, result).items():
        file = save_figure(folder / "figures" / f"{name}.png", make, dpi=160)
        if file is not None:
            out[name] = embedded(file, alt, caption)
    return out


def _wanted(folder: Path, result: Mapping[str, Any]) -> dict[str, tuple[Callable[[], "drawn.Figure"], str, str]]:
    """What draws each figure, what it shows, and its caption."""
    from btr_mjx.gap.report import figures

    out: dict[str, tuple[Callable[[], drawn.Figure], str, str]] = {}
    if (folder / "sets.csv").is_file():
        make = partial(figures.numbers_over_sets, read_table(folder / "sets.csv").to_dicts())
        caption = "Named numbers of each set, the oldest first, beside the believed model; bars are 90 % intervals."
        out["sets"] = make, "Numbers over the sets of recordings", caption
    if (folder / "joint_forces.npz").is_file():
        joints = figures.force_data(read_arrays(folder / "joint_forces.npz"))
        is_mended = bool(result.get("effects") or result.get("unnamed"))
        caption = "Force that the believed model lacks along the recordings that were fitted"
        caption += ", and force that is left beside the mended model" if is_mended else ""
        caption += "; orange: the law that was named, with its 90 % band." if any(j.law.any() for j in joints) else "."
        if joints:
            out["joint-forces"] = partial(figures.force_figure, joints, is_mended), "Missing force at joints", caption
    if (folder / "next_command.csv").is_file():
        table = read_table(folder / "next_command.csv")
        names = [name for name in table.columns if name != "time"]
        more = len(names) - 5
        caption = "The proposed command" + (f"; {more} further channels are in next_command.csv." if more > 0 else ".")
        make = partial(figures.commands, table["time"].to_numpy(), table.select(names).to_numpy(), names)
        out["next-command"] = make, "The proposed command", caption
    return out
