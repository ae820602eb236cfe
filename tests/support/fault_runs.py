"""Small runs of every command that writes a run folder."""

import csv
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import faults
from hidden_cases import CaseSettings, make_case

from btr_mjx.errors import WAITING_CODE

ROOT = Path(__file__).parents[2]
THROWER = ROOT / "examples" / "thrower"

TINY = [
    *("--engine", "native", "--duration", "0.3", "--no-progress"),
    *("--controllers", "8", "--controller-generations", "2", "--trials", "3", "--iterations", "2"),
    *("--simulations", "8", "--simulation-generations", "2"),
]

SMALL_SCAN = [
    *("--engine", "native", "--duration", "0.3", "--no-progress"),
    *("--grid", "9", "--trials", "4", "--behaviours", "random", "--block", "6"),
]


@dataclass(frozen=True)
class Run:
    """A run of a command.

    Attributes:
      module: the command.
      words: its arguments, without the folder.
      inputs: makes files that it reads in a folder, and returns the arguments that name them.
      between: called between two sessions with the run folder.
    """

    module: str
    words: tuple[str, ...]
    inputs: Callable[[Path], tuple[str, ...]] = lambda folder: ()
    between: Callable[[Path], None] | None = None

    def prepared(self, folder: Path) -> "Run":
        """The run with its files in a folder."""
        return replace(self, words=(*self.words, *self.inputs(folder)))

    def session(self, folder: Path, resume: bool = False, kill_at: int | None = None) -> faults.Session:
        """One session in the run folder FOLDER/run; where measurements are waited for, sessions until all are there."""
        changes = 0
        while True:
            left = None if kill_at is None else kill_at - changes
            words = [*self.words, "--out", "run", *(["--resume"] if resume else [])]
            session = faults.run_session(self.module, words, folder, left)
            changes += session.changes
            if session.code != WAITING_CODE or self.between is None:
                return replace(session, changes=changes)
            try:
                self.between(folder / "run")
            except OSError:  # no room for who measures: the run waits
                return replace(session, changes=changes)
            resume = True


def measured(folder: Path) -> None:
    """Write a fitness for every trial that is asked for."""
    exchange = folder / "exchange"
    for asked in sorted((exchange / "trials").glob("*.csv")):
        if (exchange / "measured" / asked.name).exists():
            continue
        rows = list(csv.DictReader(asked.read_text().splitlines()))
        lines = [f"{row['id']},{0.4 + 0.01 * (7 * int(row['id']) % 5)}" for row in rows]
        file = exchange / "measured" / asked.name
        try:
            file.write_text("\n".join(["id,fitness", *lines]) + "\n")
        except OSError:
            file.unlink(missing_ok=True)
            raise


def _thrower(folder: Path) -> tuple[str, ...]:
    if not (folder / "thrower").exists():
        shutil.copytree(THROWER, folder / "thrower")
    return "--robot", str(folder / "thrower" / "robot.toml")


def _dataset(folder: Path) -> tuple[str, ...]:
    if not (folder / "pendulum").exists():
        settings = CaseSettings(effects=("viscous_damping",), recordings=(2, 1), duration=0.8)
        make_case(folder / "pendulum", 4, "pendulum", settings)
    return (str(folder / "pendulum"),)


RUNS = {
    "coevolve": Run("btr_mjx.coevolve", (*TINY, "--no-figures"), _thrower),
    "folder": Run("btr_mjx.coevolve", (*TINY, "--no-figures", "--reality", "folder"), _thrower, measured),
    "scan": Run("btr_mjx.scan", (*SMALL_SCAN, "--no-figures"), _thrower),
    "diagnose": Run(
        "btr_mjx.diagnose",
        ("--effects", "viscous_damping", "--max-effects", "1", "--no-figures", "--no-progress"),
        _dataset,
    ),
}
