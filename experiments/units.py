"""Resumable units of work.

An experiment is a list of units, one or a few per seed. Each is computed once and written as one `.npz` file, so that
an interrupted run continues with the missing units, and more seeds can be added later. A unit that takes minutes stores
the results of its expensive calls in a journal: a resumed unit repeats its (seeded) decisions from the stored results
without simulating again.

    run_units(config, [Unit("seed-0", 1500, work), ...])        # skips what exists
    draw(config.out)                                            # from the files alone
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import Config

from btr_mjx.cluster import map_cases
from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs import (
    IGNORED_FIELDS,
    RunFolder,
    StopRequest,
    config_to_json,
    differences,
    graceful_interrupt,
    is_unused,
    note,
    progress,
    read_arrays,
    read_config_json,
    write_arrays,
)

Arrays = dict[str, np.ndarray]
Step = Callable[[float], object]

IGNORED = (*IGNORED_FIELDS, "cluster", "seeds", "parts", "truths", "draw_only")
"""Settings that may differ on resume: more seeds, or parts, are more units."""

ASSUMED_RATE = 400.0
"""Whole trials per second assumed for estimates of time: the lanes engine on two cores."""


class Journal:
    """Stores the results of a unit's expensive calls, so that a resumed unit need not simulate them again.

    Arguments of the calls are not compared: a unit makes the same calls in the same order in every run.
    """

    def __init__(self, run: RunFolder, unit: str, step: Step, stop: StopRequest, interval: float = 15.0) -> None:
        """Load the stored results of this unit from the folder's newest checkpoint.

        Args:
          run: the open run folder.
          unit: name of the unit.
          step: called with the number of whole trials of a call whose result was stored.
          stop: checked after each call.
          interval: minimum time between two checkpoints [s].
        """
        self._run, self._unit, self._step, self._stop, self._interval = run, unit, step, stop, interval
        checkpoint = run.load_latest()
        self._number = 0 if checkpoint is None else checkpoint.step + 1
        mine = checkpoint is not None and checkpoint.meta.get("unit") == unit
        self._values = (
            [checkpoint.arrays[f"{i:06d}"] for i in range(checkpoint.meta["calls"])] if checkpoint and mine else []
        )
        self._next, self._saved = 0, time.monotonic()

    def __call__(self, compute: Callable[[], np.ndarray], trials: float) -> np.ndarray:
        """The value of `compute()`, or its stored result.

        Args:
          compute: simulates `trials` whole trials and reports them to the progress bar itself.
          trials: their number.

        Raises:
          Interrupted: a signal asked to stop; what was computed is saved.
        """
        if self._next < len(self._values):
            self._step(trials)
        else:
            self._values.append(np.asarray(compute()))
            if self._stop.requested or time.monotonic() - self._saved >= self._interval:
                self.save()
            self._stop.checkpoint()
        self._next += 1
        return self._values[self._next - 1]

    def save(self) -> None:
        """Write a checkpoint."""
        arrays = {f"{i:06d}": value for i, value in enumerate(self._values)}
        self._run.save_checkpoint(self._number, arrays, {"unit": self._unit, "calls": len(arrays)})
        self._number, self._saved = self._number + 1, time.monotonic()


@dataclass(frozen=True)
class Unit:
    """A unit of work.

    Attributes:
      name: stem of its file.
      trials: its cost, in whole trials.
      work: computes its arrays, given the progress callback and the journal.
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
    """One line with the number of missing units and the expected time."""
    return (
        f"{trials:,.0f} whole trials to simulate, {trials / ASSUMED_RATE / 60:.1f} min at {ASSUMED_RATE:.0f} a second"
    )


def run_units(config: Config, units: Sequence[Unit], description: str) -> int:
    """Compute the units that are missing in the run folder; see `Config.out`, `resume` and `draw_only`.

    Args:
      config: the settings, which must equal those with which the folder was started.
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
            if config.cluster is not None:
                units_by_name = {unit.name: unit for unit in left}
                compute = lambda name: compute_whole(units_by_name[name])  # noqa: E731
                for name, arrays in map_cases(compute, units_by_name, config.cluster, jax_backend=True):
                    write_arrays(folder / f"{name}.npz", arrays)
                    step(units_by_name[name].trials)
                    stop.checkpoint()
                return len(left)
            for unit in left:
                bar.set_description(f"{description} {unit.name}")
                arrays = unit.work(step, Journal(run, unit.name, step, stop))
                write_arrays(folder / f"{unit.name}.npz", arrays)
                stop.checkpoint()
    return len(left)


def compute_whole(unit: Unit) -> Arrays:
    """The arrays of a unit, computed without a journal; on a cluster a lost unit is computed again from its start."""
    journal: Any = lambda compute, trials: np.asarray(compute())  # noqa: E731
    return unit.work(lambda trials: None, journal)


def whole_steps(update: Callable[[int], object]) -> Step:
    """A progress callback for fractions, which accumulates them and passes whole numbers on."""
    rest = 0.0

    def step(count: float) -> None:
        nonlocal rest
        rest += count
        # Tolerance for rounding: ten steps of a tenth make one.
        whole = int(rest + 1e-6)
        rest -= whole
        update(whole)

    return step


def differences_to_saved(config: Config) -> list[str]:
    """Differences of these settings from those of the folder that affect results."""
    return differences(read_config_json(config.folder), config_to_json(config), IGNORED)


def load(folder: Path, prefix: str) -> list[Arrays]:
    """Arrays of the finished units with a name, by seed: "seed" finds seed-0.npz, seed-1.npz, ...

    Raises:
      InputError: there is none.
    """
    paths = sorted(folder.glob(f"{prefix}-*.npz"), key=lambda path: int(path.stem.rpartition("-")[2]))
    if not paths:
        raise InputError(f"{folder} holds no {prefix}-*.npz: nothing was computed yet; run without --draw-only")
    return [read_arrays(path) for path in paths]
