"""Film what a run found: `python -m btr_mjx.replay runs/quick-0`.

Of a co-evolution: the controller of iteration 1 that the simulation of the start predicts to be the best, there and in
reality, and below them the one that was best in reality in the last iteration, in the identified simulation and in
reality. Of a diagnosis: a held-out recording beside the believed model and the mended
one, which start as it does and get its command. Trials are simulated again in native MuJoCo, in float64.
Errors too small to be seen: `--magnify 10 --overlay` draws ten times the error, and the measured motion over it.

The film is a GIF, or an MP4 with the extra `video`; its labels say what is shown, the time and the fitness. The page of
the run (report.html) then holds the film too. Without EGL, OSMesa or a display there is none, and a line says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.report import report
from btr_mjx.runs import parsed


@dataclass(frozen=True)
class ReplayConfig:
    """Settings of a replay; every field is a flag."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder of btr_mjx.coevolve or btr_mjx.diagnose."""
    out: Path | None = None
    """The film, .gif or .mp4; by default replay.gif in the run folder."""
    view: bool = False
    """Play the motions in MuJoCo's viewer instead, one after another; needs a display."""
    magnify: float = 1.0
    """Draw simulated motions with so many times their error: the difference of positions from the measured motion."""
    overlay: bool = False
    """Draw the measured motion over the simulated ones, half transparent."""
    seconds: float = 6.0
    """Length of the film [s]: a trial is slowed down to it, of a longer recording this much is shown."""
    rate: int = 12
    """Frames per second."""
    width: int = 320
    """Width of each panel [pixels]."""
    limit: float = 2.0
    """Largest size of a GIF [MB]; a film that is larger is made smaller, in pixels."""
    progress: bool = True
    """Show progress. --quiet is another name of --no-progress."""


def check_replay(config: ReplayConfig) -> Path:
    """Check settings.

    Returns:
      The film.

    Raises:
      InputError: a setting that is out of its range, or a film that cannot be written.
    """
    ranges = (("seconds", 0.1, 120.0), ("rate", 1, 50), ("width", 120, 960), ("limit", 0.05, 100.0))
    for name, low, high in (*ranges, ("magnify", 1, 1000)):
        value = getattr(config, name)
        if not low <= value <= high:
            raise InputError(f"{name}: got {value}, expected {low:g} to {high:g}")
    from btr_mjx.replays import check_display, check_film

    if config.view:
        check_display()
    out = config.out or config.run / "replay.gif"
    check_film(out)
    from btr_mjx.runs import check_file_place

    if not config.view and config.run.is_dir():
        check_file_place(out)
    return out


def replay(config: ReplayConfig) -> Path | None:
    """Film a run, or show it in the viewer.

    Args:
      config: the settings.

    Returns:
      The film; None with `view`, or where nothing can be rendered, which one line on stderr says.

    Raises:
      InputError: bad settings, no run that can be shown, no display.
    """
    out = check_replay(config)
    from btr_mjx.pages import PAGE
    from btr_mjx.plotting import attempt
    from btr_mjx.replays import draw_film, magnified, read_replay, view_replay, write_film
    from btr_mjx.runs import progress

    frames = max(2, round(config.seconds * config.rate))
    shown = magnified(read_replay(config.run, frames, config.seconds), config.magnify)
    slowness = len(shown.times) / config.rate / float(shown.times[-1])
    if config.view:
        view_replay(shown, slowness)
        return None
    total = len(shown.motions) * len(shown.times)
    with progress(total=total, description="film", unit="frames", show=config.progress) as bar:
        film = attempt("film", lambda: draw_film(shown, config.width, slowness, bar.update, config.overlay))
    if film is None:
        return None
    write_film(out, film, config.rate, round(config.limit * 1e6))
    if (config.run / PAGE).is_file() and out.resolve().parent == config.run.resolve():
        attempt(PAGE, lambda: report(config.run))
    return out


@cli_errors()
def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    config = parsed(ReplayConfig, argv, description=__doc__, prog="btr_mjx.replay")
    out = replay(config)
    if out is not None:
        print(f"{out} ({out.stat().st_size / 1e6:.2f} MB)")


if __name__ == "__main__":
    main()
