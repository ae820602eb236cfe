"""Drawing of all figures of a run folder: reads its saved files, applies the style, saves the figures.

The figures themselves are made in `figures` and `robot_figure`.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from btr_mjx.errors import InputError
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


def draw_run(folder: Path) -> list[Path]:
    """Draw the figures of a run folder of `btr_mjx.coevolve`.

    Args:
      folder: the run folder.

    Returns:
      The PNG files.

    Raises:
      InputError: not a run folder, a run that has not ended, or a damaged file.
    """
    folder = Path(folder)
    run = read_run(folder)
    from btr_mjx.plotting import figures, robot_figure  # matplotlib takes seconds, which bad input should not

    curves = {
        "controller_fitness": figures.controller_fitness,
        "delta_fitness": figures.delta_fitness_curve,
        "parameters": figures.parameter_values,
        "sim_versus_reality": figures.sim_versus_reality,
    }
    saved = [_save(folder / f"{name}.png", partial(make, run)) for name, make in curves.items()]
    try:
        robot = read_robot(folder)
    except InputError as error:  # its template has been moved or deleted
        note(f"no picture of the robot: {error}")
        return saved
    return [*saved, _save(folder / "robot.png", partial(robot_figure.morphologies, robot, run))]


def draw_scan(folder: Path) -> list[Path]:
    """Draw the figure of a run folder of `btr_mjx.scan`; returns and raises as `draw_run`."""
    folder = Path(folder)
    data = read_scan(folder)
    from btr_mjx.plotting import figures

    return [_save(folder / "scan.png", partial(figures.scan_curve, data))]


def draw_folder(folder: Path) -> list[Path]:
    """Draw the figures of either kind of run folder; returns and raises as `draw_run`."""
    return draw_scan(folder) if (Path(folder) / "scan.npz").is_file() else draw_run(folder)


def _save(path: Path, make: "Callable[[], Figure]") -> Path:
    with style():
        write_figure(path, make())
    return path
