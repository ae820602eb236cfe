"""What the experiments share: settings, units of work that survive a kill, and a bench to try behaviours on.

An experiment is a list of units, one or a few per seed. Each is computed once and written as one `.npz` file, so that a
run that was killed goes on with the units that are missing, and more seeds can be added later. A unit that takes
minutes is made of calls that its journal remembers: a resumed unit repeats its decisions (all seeded) from the
remembered numbers, without simulating anything twice.

    run_units(config, [Unit("seed-0", 1500, work), ...])        # skips what exists
    draw(config.out)                                            # from the files alone
"""

import dataclasses
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from btr_mjx.behaviour import EngineSettings, evaluate
from btr_mjx.btr_state import SearchSettings
from btr_mjx.configs import config_to_json, differences, read_config, read_config_json
from btr_mjx.distances import fitness_at_marks
from btr_mjx.errors import DamagedFile, InputError, cli_errors
from btr_mjx.files import read_arrays, write_arrays
from btr_mjx.fitness import DISTANCE
from btr_mjx.progress import graceful_interrupt, note, progress
from btr_mjx.robots import Robot, robot_of
from btr_mjx.runs import IGNORED_FIELDS, RunFolder, is_unused

Arrays = dict[str, np.ndarray]
Step = Callable[[float], object]

IGNORED = (*IGNORED_FIELDS, "seeds", "draw_only")
"""Settings that may change when a folder is taken up again: more seeds are more units."""

ASSUMED_RATE = 500.0
"""Whole trials per second that the estimates of time assume; two quiet cores reach it with the lanes engine."""


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
"""Settings that every experiment's preset "tiny" shares: seconds, and no result."""


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
        """The run folder; `with_folder` makes sure that there is one."""
        assert self.out is not None
        return self.out

    def with_folder(self, name: str) -> "Config":
        """With the default run folder where none was given."""
        return self if self.out else dataclasses.replace(self, out=Path("runs", f"experiments-{self.preset}", name))

    def check(self) -> None:
        """Refuse what no experiment can do.

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
    default = presets.get(chosen, presets["quick"])  # tyro names the valid ones if it is neither
    config: Any = tyro.cli(type(default), args=words, default=default, description=doc, prog=name)
    return config.with_folder(name), words


# ---- units of work ----


class Journal:
    """Remembers the numbers of a unit's expensive calls, so that a resumed unit need not simulate them again.

    Args of the calls are not compared: a unit makes the same calls in the same order whenever it is run.
    """

    def __init__(self, run: RunFolder, unit: str, step: Step, interval: float = 15.0) -> None:
        """Take up what the folder's newest checkpoint remembers of this unit.

        Args:
          run: the open run folder.
          unit: name of the unit.
          step: called with the number of whole trials that a remembered call stood for.
          interval: least time between two checkpoints [s].
        """
        self._run, self._unit, self._step, self._interval = run, unit, step, interval
        checkpoint = run.load_latest()
        self._number = 0 if checkpoint is None else checkpoint.step + 1
        mine = checkpoint is not None and checkpoint.meta.get("unit") == unit
        self._values = (
            [checkpoint.arrays[f"{i:06d}"] for i in range(checkpoint.meta["calls"])] if checkpoint and mine else []
        )
        self._next, self._saved = 0, time.monotonic()

    def __call__(self, compute: Callable[[], np.ndarray], trials: float) -> np.ndarray:
        """The value of `compute()`, from memory where it was computed before.

        Args:
          compute: simulates `trials` whole trials and reports them to the progress bar itself.
          trials: their number.
        """
        if self._next < len(self._values):
            self._step(trials)
        else:
            self._values.append(np.asarray(compute()))
            if time.monotonic() - self._saved >= self._interval:
                self.save()
        self._next += 1
        return self._values[self._next - 1]

    def save(self) -> None:
        """Write a checkpoint."""
        arrays = {f"{i:06d}": value for i, value in enumerate(self._values)}
        self._run.save_checkpoint(self._number, arrays, {"unit": self._unit, "calls": len(arrays)})
        self._number, self._saved = self._number + 1, time.monotonic()


@dataclass(frozen=True)
class Unit:
    """A piece of work that is done once.

    Attributes:
      name: stem of its file.
      trials: what it simulates, in whole trials.
      work: makes its arrays; takes the progress bar's step and the journal.
    """

    name: str
    trials: float
    work: Callable[[Step, Journal], Arrays]


def missing(folder: Path, units: Sequence[Unit]) -> list[Unit]:
    """Units whose file is absent; a damaged file is removed and counts as absent."""
    left = []
    for unit in units:
        path = folder / f"{unit.name}.npz"
        try:
            read_arrays(path, require_digest=True)
        except FileNotFoundError:
            left.append(unit)
        except DamagedFile as error:
            note(f"warning: {error}; computed again")
            with suppress(OSError):
                path.unlink()
            left.append(unit)
    return left


def estimate(trials: float) -> str:
    """A line on what is to come."""
    return (
        f"{trials:,.0f} whole trials to simulate, {trials / ASSUMED_RATE / 60:.1f} min at {ASSUMED_RATE:.0f} a second"
    )


def run_units(config: Config, units: Sequence[Unit], description: str) -> int:
    """Compute the units that are missing in the run folder; see `Config.out`, `resume` and `draw_only`.

    Args:
      config: the settings; the folder refuses others than it was started with.
      units: all units.
      description: for the progress bar.

    Returns:
      The number of units computed now.

    Raises:
      InputError: the folder belongs to another config, or is unfinished and --resume was not given.
    """
    folder = config.folder
    if config.draw_only:
        return 0
    if not is_unused(folder) and not missing(folder, units):
        changed = differences_to_saved(config)
        if changed:
            raise InputError(f"{folder} was computed with other settings ({'; '.join(changed)}); give another --out")
        return 0
    with RunFolder.create(folder, config, config.resume, ignore=IGNORED) as run, graceful_interrupt() as stop:
        left = missing(folder, units)
        total = sum(unit.trials for unit in left)
        if config.progress:
            note(f"{description}: {len(left)} of {len(units)} units left, {estimate(total)}")
        with progress(total=round(total), description=description, unit="trials", show=config.progress) as bar:
            step = whole_steps(bar.update)
            for unit in left:
                bar.set_description(f"{description} {unit.name}")
                arrays = unit.work(step, Journal(run, unit.name, step))
                write_arrays(folder / f"{unit.name}.npz", arrays)
                stop.checkpoint()
    return len(left)


def whole_steps(update: Callable[[int], object]) -> Step:
    """A step that takes fractions and passes whole numbers on."""
    rest = 0.0

    def step(count: float) -> None:
        nonlocal rest
        rest += count
        # A hair more, so that ten steps of a tenth make one.
        whole = int(rest + 1e-6)
        rest -= whole
        update(whole)

    return step


def differences_to_saved(config: Config) -> list[str]:
    """How these settings differ from those of the folder, where it matters."""
    return differences(read_config_json(config.folder), config_to_json(config), IGNORED)


def load(folder: Path, prefix: str) -> list[Arrays]:
    """The finished units whose names begin so, by seed: "seed" finds seed-0.npz, seed-1.npz, ...

    Raises:
      InputError: there is none.
    """
    paths = sorted(folder.glob(f"{prefix}-*.npz"), key=lambda path: int(path.stem.rpartition("-")[2]))
    if not paths:
        raise InputError(f"{folder} holds no {prefix}-*.npz: nothing was computed yet; run without --draw-only")
    return [read_arrays(path) for path in paths]


def saved[T: Config](config: T) -> T:
    """The settings that a folder was computed with, for drawing alone."""
    return dataclasses.replace(read_config(config.folder, type(config)), out=config.out)


def command[T: Config](
    presets: dict[str, T],
    doc: str | None,
    name: str,
    argv: Sequence[str] | None,
    compute: Callable[[T], int],
    draw: Callable[[Path], Sequence[Path]],
) -> None:
    """The command of an experiment: compute what is missing, then draw.

    Args:
      presets: settings by preset.
      doc: description.
      name: of the experiment.
      argv: arguments; None for those of this process.
      compute: computes what is missing, returns how many units it computed.
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


# ---- trying behaviours ----


@dataclass(frozen=True)
class Bench:
    """Where behaviours are tried.

    Attributes:
      robot: the robot, with the experiment's duration.
      engine: the engine, None for the fastest.
      marks: marks of the multiscale distance [s].
      step: progress, in whole trials.
    """

    robot: Robot
    engine: Any
    marks: tuple[float, ...]
    step: Step

    @classmethod
    def of(cls, config: Config, step: Step) -> "Bench":
        """The bench of an experiment."""
        engine = None if config.engine == "auto" else config.engine
        return cls(robot_of(None, config.duration), engine, config.mark_times, step)

    def with_marks_until(self, horizon: float) -> "Bench":
        """The same bench with as many marks, the last one at `horizon` [s]."""
        count = len(self.marks)
        return dataclasses.replace(self, marks=tuple(np.linspace(horizon / count, horizon, count).tolist()))

    def early(self, simulations: np.ndarray, controllers: np.ndarray, settings: EngineSettings | None = None) -> Any:
        """Fitness at the marks (L, M, K) of trials that end at the last mark; NaN where a pair diverged."""
        return self._fitness(simulations, controllers, self.marks, settings)

    def whole(self, simulations: np.ndarray, controllers: np.ndarray, settings: EngineSettings | None = None) -> Any:
        """Fitness at the marks and at T_e, (L, M, K + 1), of whole trials; the last entry is f_s."""
        return self._fitness(simulations, controllers, (*self.marks, self.robot.duration), settings)

    def _fitness(
        self,
        simulations: np.ndarray,
        controllers: np.ndarray,
        times: tuple[float, ...],
        settings: EngineSettings | None,
    ) -> np.ndarray:
        share = times[-1] / self.robot.duration
        evaluation = evaluate(
            self.robot,
            simulations,
            controllers,
            engine=self.engine if settings is None else "native",
            times=times,
            settings=settings or EngineSettings(),
            progress=lambda pairs: self.step(pairs * share),
        )
        return np.where(evaluation.diverged[..., None], np.nan, fitness_at_marks(evaluation.outcome, DISTANCE))
