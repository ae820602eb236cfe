"""Settings and the command line that the experiments share.

An experiment is a list of units of work (`units.py`), which mostly evaluate behaviours (`bench.py`). A script defines
the units and how to draw the figure from their files.
"""

import dataclasses
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from btr_mjx.backtoreality import SearchSettings
from btr_mjx.errors import InputError, cli_errors

TINY: dict[str, Any] = {
    "engine": "native",
    "duration": 0.05,
    "horizon": 0.02,
    "marks": 2,
    "seeds": 2,
    "trials": 3,
    "population": 6,
    "generations": 2,
}
"""Common settings of the preset "tiny", which takes seconds and is for tests only."""


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of every experiment; every field is a flag."""

    preset: Literal["quick", "paper", "tiny"] = "quick"
    """Defaults of all other settings: quick takes minutes, paper is what decides the claims, tiny is for tests."""
    seeds: int = 3
    """Seeds 0 .. N - 1; more can be added to a folder later."""
    out: Path | None = None
    """Run folder; by default runs/experiments-<preset>/<name>."""
    resume: bool = False
    """Continue the run in --out."""
    draw_only: bool = False
    """Draw the figure from the saved files and simulate nothing."""
    progress: bool = True
    """Show a progress bar."""
    engine: Literal["auto", "lanes", "mjx", "native"] = "auto"
    """How simulations are computed; auto takes the fastest that can."""
    cluster: str | None = None
    """Compute units on a Dask cluster: local:N, tcp://HOST:PORT or file:SCHEDULER.json."""
    duration: float = 1.7
    """T_e, duration of a trial [s]."""
    horizon: float = 0.2
    """Last mark of the multiscale distance [s]."""
    marks: int = 8
    """Its number of marks, evenly spaced."""
    trials: int = 15
    """m, number of behaviours."""
    population: int = 60
    """M of the controllers' evolution (step 1)."""
    generations: int = 10
    """Its generations."""

    @property
    def mark_times(self) -> tuple[float, ...]:
        """Marks of the multiscale distance [s]."""
        return tuple(np.linspace(self.horizon / self.marks, self.horizon, self.marks).tolist())

    @property
    def search(self) -> SearchSettings:
        """Settings of step 1."""
        return SearchSettings(self.population, self.generations)

    @property
    def folder(self) -> Path:
        """The run folder, see `with_folder`."""
        assert self.out is not None
        return self.out

    def with_folder(self, name: str) -> "Config":
        """The settings with the default run folder if none is given."""
        return self if self.out else dataclasses.replace(self, out=Path("runs", f"experiments-{self.preset}", name))

    def check(self) -> None:
        """Check settings that all experiments share.

        Raises:
          InputError: bad settings.
        """
        if self.seeds < 1 or self.trials < 2 or self.marks < 1:
            raise InputError(
                f"seeds {self.seeds}, trials {self.trials}, marks {self.marks}: expected at least 1, 2 and 1"
            )
        if self.trials >= self.search.population:
            raise InputError(f"trials m = {self.trials}: expected fewer than the population M = {self.population}")
        if not 0 < self.horizon < self.duration:
            raise InputError(f"horizon: got {self.horizon} s, expected within the trial of {self.duration} s")


def parse[T: Config](
    presets: dict[str, T], doc: str | None, name: str, argv: Sequence[str] | None
) -> tuple[T, list[str]]:
    """Read the command line; --preset chooses the defaults of all other flags.

    Args:
      presets: settings by preset.
      doc: description of the command.
      name: of the experiment, for its default folder.
      argv: arguments; None for those of this process.

    Returns:
      The settings, with a folder, and the arguments.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    chosen = "quick"
    for position, word in enumerate(words):
        if word == "--preset" and position + 1 < len(words):
            chosen = words[position + 1]
        elif word.startswith("--preset="):
            chosen = word.removeprefix("--preset=")
    default = presets.get(chosen, presets["quick"])  # for another value, tyro's error names the valid ones
    config: Any = tyro.cli(type(default), args=words, default=default, description=doc, prog=name)
    return config.with_folder(name), words


def command[T: Config](
    presets: dict[str, T],
    doc: str | None,
    name: str,
    argv: Sequence[str] | None,
    compute: Callable[[T], int],
    draw: Callable[[Path], Sequence[Path]],
) -> None:
    """The command of an experiment: compute the missing units, then draw.

    Args:
      presets: settings by preset.
      doc: description.
      name: of the experiment.
      argv: arguments; None for those of this process.
      compute: computes the missing units and returns their number.
      draw: summarises and draws from the files of a folder; returns the files it wrote.
    """
    config, words = parse(presets, doc, name, argv)
    again = [word for word in words if word != "--resume"] + ([] if "--out" in words else ["--out", str(config.out)])
    with cli_errors(f"python experiments/{name}.py {' '.join(again)} --resume"):
        if not config.draw_only:
            config.check()
            compute(config)
        for path in draw(config.folder):
            print(path)
