"""Every figure of a run folder, drawn from its saved files only: `python -m btr_mjx.plotting.draw runs/quick-0`.

What is drawn is decided in `figures` and `robot_figure`; here they are read for, styled and saved.
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


@contextmanager
def style() -> Iterator[None]:
    """The look of every figure, for making and for saving it; what the caller had set comes back at the end."""
    import matplotlib.style

    with matplotlib.style.context(["default", STYLE]):
        yield


def draw_run(folder: Path) -> list[Path]:
    """Draw the figures of a run folder of `btr_mjx.coevolve`.

    Args:
      folder: where the run saved its files.

    Returns:
      The PNG files.

    Raises:
      InputError: no run folder, one whose run has not ended, or a damaged file.
    """
    from btr_mjx.plotting import figures, robot_figure

    folder = Path(folder)
    run = read_run(folder)
    curves = {
        "controller_fitness": figures.controller_fitness,
        "delta_fitness": figures.delta_fitness_curve,
        "limb_lengths": figures.limb_lengths,
        "sim_versus_reality": figures.sim_versus_reality,
    }
    saved = [_save(folder / f"{name}.png", partial(make, run)) for name, make in curves.items()]
    try:
        robot = read_robot(folder)
    except InputError as error:  # its template was moved or deleted since
        note(f"no picture of the robot: {error}")
        return saved
    return [*saved, _save(folder / "robot.png", partial(robot_figure.morphologies, robot, run))]


def draw_scan(folder: Path) -> list[Path]:
    """Draw the figure of a run folder of `btr_mjx.scan`; as `draw_run`."""
    from btr_mjx.plotting import figures

    folder = Path(folder)
    data = read_scan(folder)
    return [_save(folder / "scan.png", partial(figures.scan_curve, data))]


def draw_folder(folder: Path) -> list[Path]:
    """Draw the figures of either kind of run folder; as `draw_run`."""
    return draw_scan(folder) if (Path(folder) / "scan.npz").is_file() else draw_run(folder)


def _save(path: Path, make: "Callable[[], Figure]") -> Path:
    with style():
        write_figure(path, make())
    return path
