"""Drawing of all figures of a run folder: reads its saved files, applies the style, saves the figures.

The figures themselves are made in `figures` and `robot_figure`.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from btr_mjx.errors import is_bad_input, one_line
from btr_mjx.plotting.run_data import read_robot, read_run, read_scan
from btr_mjx.runs import note, write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = Path(__file__).with_name("style.mplstyle")
"""Matplotlib style sheet of all figures."""


@contextmanager
def style() -> Iterator[None]:
    """Context in which figures are made and saved with the common style; restores the caller's settings at the end."""
    import matplotlib.style

    with matplotlib.style.context(["default", STYLE]):
        yield


def attempt[T](what: str, draw: Callable[[], T]) -> T | None:
    """What a drawing function returns; None where it fails, which one line on stderr says: no figure ends a run.

    Args:
      what: is drawn, such as "scan.png".
      draw: the function.
    """
    try:
        return draw()
    except Exception as error:
        kind = "" if is_bad_input(error) else f"{type(error).__name__}: "
        note(f"no {what}: {kind}{one_line(error)}")
        return None


def save_figure(path: Path, make: "Callable[[], Figure | None]", dpi: int = 150) -> Path | None:
    """Make a figure with the common style and save it; None where there is none, or where it fails (see `attempt`)."""

    def draw() -> Path | None:
        with style():
            figure = make()
            if figure is not None:
                write_figure(path, figure, dpi=dpi)
        return path if figure is not None else None

    return attempt(path.name, draw)


def draw_run(folder: Path) -> list[Path]:
    """Draw the figures of a run folder of `btr_mjx.coevolve`; the PNG files.

    Figures that fail are left out, which one line each on stderr says.

    Raises:
      InputError: not a run folder, a run that has not ended, or a damaged file.
    """
    folder = Path(folder)
    run = read_run(folder)
    from btr_mjx.plotting import robot_figure, run_figures  # matplotlib takes seconds, which bad input should not

    curves = {
        "controller_fitness": run_figures.controller_fitness,
        "delta_fitness": run_figures.delta_fitness_curve,
        "parameters": run_figures.parameter_values,
        "sim_versus_reality": run_figures.sim_versus_reality,
        # Last, since its template may have been moved or deleted.
        "robot": lambda run: robot_figure.morphologies(read_robot(folder), run),
    }
    saved = [save_figure(folder / f"{name}.png", partial(make, run)) for name, make in curves.items()]
    return [path for path in saved if path is not None]


def draw_scan(folder: Path) -> list[Path]:
    """Draw the figure of a run folder of `btr_mjx.scan`; returns and raises as `draw_run`."""
    folder = Path(folder)
    data = read_scan(folder)
    from btr_mjx.plotting import run_figures

    path = save_figure(folder / "scan.png", partial(run_figures.scan_curve, data))
    return [] if path is None else [path]


def draw_folder(folder: Path) -> list[Path]:
    """Draw the figures of either kind of run folder; returns and raises as `draw_run`."""
    return draw_scan(folder) if (Path(folder) / "scan.npz").is_file() else draw_run(folder)
