"""Reality behind a folder: the program writes what is to be tried, a person or another program writes what came out.

    exchange/
      README.md             what to do
      trials/001.csv        id and parameters of the controllers of iteration 1
      signals/trial-7.csv   reference signal of trial 7: time and a column for each motor
      measured/001.csv      id, fitness (and repeats, failed): written by whoever tries them
      measured/trial-7.csv  or a recording of trial 7, from which the fitness is computed
      used/001.csv          what the run went on with; it does not change any more

Nothing that was measured is lost or asked for twice: a batch that is in `used` is read from there.
"""

import csv
import hashlib
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.backtoreality.reality.instructions import Rounds, instructions
from btr_mjx.backtoreality.reality.measurements import (
    RECORDING_SUFFIXES,
    Measured,
    read_recorded_fitness,
    read_table_of_fitness,
)
from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.evaluation import FitnessFunction, FitnessLike, fitness_of
from btr_mjx.gap.data import Recording, make_recording, read_columns, with_bases
from btr_mjx.models import base_model, control_names
from btr_mjx.robots import Robot
from btr_mjx.runs import atomic_write, note

_END = "# sha256 "
"""Beginning of the last line of a table in `used`, before the digest of the lines above it."""


class Waiting(Exception):
    """Trials have not been measured yet.

    Attributes:
      missing: their ids.
      complaints: what could not be used, a sentence each.
      folder: where measurements are looked for.
      table: the table that is looked for.
    """

    def __init__(self, missing: Sequence[int], complaints: Sequence[str], folder: Path, table: str) -> None:
        self.missing, self.complaints, self.folder, self.table = tuple(missing), tuple(complaints), folder, table
        few = ", ".join(map(str, missing[:12])) + (", ..." if len(missing) > 12 else "")
        what = "1 measurement" if len(missing) == 1 else f"{len(missing)} measurements"
        super().__init__(f"waiting for {what} (trials {few}) in {folder / table}")


@dataclass(frozen=True)
class FolderReality:
    """A robot that is reached through files, see the module's docstring.

    Attributes:
      robot: the robot, whose signal is sampled for the trials.
      folder: the exchange folder.
      fitness: of recordings, see `evaluate`.
      rate: samples per second of the reference signals.
      rounds: how the run goes on, for the instructions.
    """

    robot: Robot
    folder: Path
    fitness: FitnessLike | None = None
    rate: float = 200.0
    rounds: Rounds = field(default_factory=Rounds)

    def measure(self, controllers: np.ndarray, trial: int, times: tuple[float, ...]) -> np.ndarray:
        """Fitness of controllers, see `Reality.measure`.

        Raises:
          Waiting: some have not been measured yet; the files that ask for them are there.
          InputError: the folder is that of another run, or a measurement does not have what the run needs.
        """
        ids = range(trial, trial + len(controllers))
        name = f"{self._batch(trial):03d}.csv"
        self._ask(name, ids, controllers)
        used = self.folder / "used" / name
        if not used.is_file():
            found, complaints = self._look(name, ids, times)
            missing = [i for i in ids if i not in found]
            if missing:
                raise Waiting(missing, complaints, self.folder / "measured", name)
            for complaint in complaints:
                note(complaint)
            self._write_used(used, ids, found, times)
        return self._read_used(used, ids, times)

    @property
    def noise(self) -> float:
        """Standard deviation of a single measurement, from all repeats so far; NaN where nothing was repeated."""
        squares = [
            float(row["scatter"]) ** 2
            for path in sorted((self.folder / "used").glob("*.csv"))
            for row in _used_rows(path)
            if row["scatter"] not in ("", "nan")
        ]
        return math.sqrt(sum(squares) / len(squares)) if squares else math.nan

    def record(self, controllers: np.ndarray, trials: ArrayLike) -> list[Recording]:
        """Recordings of trials with these ids (m,), of those that were given one."""
        files = (self._recording(int(i)) for i in np.asarray(trials))
        model = base_model(self.robot)
        found = [make_recording(read_columns(path), model, str(path), path.stem) for path in files if path is not None]
        return with_bases([found], [])[0]

    @property
    def _function(self) -> FitnessFunction:
        return fitness_of(self.robot, self.fitness)

    def _recording(self, trial: int) -> Path | None:
        """The recording of a trial, if there is one."""
        names = (self.folder / "measured" / f"trial-{trial}{suffix}" for suffix in RECORDING_SUFFIXES)
        return next((path for path in names if path.is_file()), None)

    def _batch(self, trial: int) -> int:
        """Number of the batch that begins with a trial: 0 for the first controller, then that of the iteration."""
        following = 0
        for number in count():
            path = self.folder / "trials" / f"{number:03d}.csv"
            if not path.is_file():
                break
            ids = [row.partition(b",")[0] for row in path.read_bytes().splitlines()[1:]]
            if not ids or not all(i.isdigit() for i in ids) or int(ids[0]) != following:
                raise self._foreign(f"{path} does not begin with trial {following}")
            if following == trial:
                return number
            following += len(ids)
        if trial != following:
            raise self._foreign(f"trial {trial} begins no batch there")
        return number

    def _ask(self, name: str, ids: range, controllers: np.ndarray) -> None:
        """Write the trials of a batch, their signals and the instructions, where they are not there yet."""
        table = _table(
            ["id", *self.robot.controller_box.names],
            [[i, *map(repr, row.tolist())] for i, row in zip(ids, controllers, strict=True)],
        )
        path = self.folder / "trials" / name
        if path.is_file() and path.read_bytes() != table:
            raise self._foreign(f"{path} has other trials than this run asks for")
        names = control_names(base_model(self.robot))
        time = np.arange(0.0, self.robot.duration + 0.5 / self.rate, 1.0 / self.rate)
        for i, controller in zip(ids, controllers, strict=True):
            values = np.stack([self.robot.signal(controller[:, None], t, np)[:, 0] for t in time])
            rows = [[f"{t:.6g}", *(f"{v:.9g}" for v in row)] for t, row in zip(time, values, strict=True)]
            signal = _table(["time", *(f"ctrl/{motor}" for motor in names)], rows)
            _write(self.folder / "signals" / f"trial-{i}.csv", signal)
        _write(self.folder / "README.md", instructions(self.robot, self._function, self.rate, self.rounds).encode())
        (self.folder / "measured").mkdir(parents=True, exist_ok=True)
        _write(path, table)  # last: a batch is there when its table is

    def _look(self, name: str, ids: range, times: tuple[float, ...]) -> tuple[dict[int, Measured], list[str]]:
        """What has been measured of a batch, and what could not be used."""
        folder, complaints = self.folder / "measured", list[str]()
        found: dict[int, Measured] = {}
        speed = self._function.unit == "m/s"
        if (folder / name).is_file():
            found, complaints = read_table_of_fitness(folder / name, ids, self.robot.speed_limit if speed else None)
        for i in ids:
            path = self._recording(i)
            if path is None:
                continue
            measured, problem = read_recorded_fitness(path, self.robot, self._function, times)
            if measured is None:
                complaints.append(problem)
            elif i in found:
                complaints.append(f"trial {i} is in {name} and in {path.name}: the table counts")
            else:
                found[i] = measured
        if len(times) > 1:
            bare = [i for i, measured in found.items() if not measured.failed and len(measured.fitness[0]) < len(times)]
            if bare:
                raise InputError(
                    f"{folder / name}: this run compares the fitness at {len(times)} times of a trial, which a table "
                    f"of final fitness does not have (trial {bare[0]}); give recordings, or run with --distance fitness"
                )
        return found, complaints

    def _write_used(self, path: Path, ids: range, found: dict[int, Measured], times: tuple[float, ...]) -> None:
        head = ["id", *(f"fitness at {time:g} s" for time in times), "measurements", "scatter", "failed"]
        rows = []
        for i in ids:
            own = found[i]
            values = [math.nan] * len(times) if own.failed else own.mean.tolist()
            rows.append([i, *map(repr, values), sum(own.weight), repr(own.scatter), int(own.failed)])
        content = _table(head, rows)
        _write(path, content + _END.encode() + hashlib.sha256(content).hexdigest().encode() + b"\n")

    def _read_used(self, path: Path, ids: range, times: tuple[float, ...]) -> np.ndarray:
        rows = [row.values() for row in _used_rows(path)]
        try:
            known = {int(i): [float(value) for value in values[: len(times)]] for i, *values in rows}
            return np.array([known[i] for i in ids])
        except (KeyError, ValueError, IndexError):
            raise self._foreign(f"{path} does not hold the measurements of trials {ids[0]} to {ids[-1]}") from None

    def _foreign(self, why: str) -> InputError:
        return InputError(f"{self.folder}: this is the exchange folder of another run ({why}); give another --exchange")


def _used_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a table in `used`; DamagedFile if it was altered."""
    content, _, digest = path.read_bytes().rpartition(_END.encode())
    if hashlib.sha256(content).hexdigest().encode() != digest.strip():
        raise DamagedFile(
            f"{path}: the file was altered; restore it, or delete it so that what was measured is read again"
        )
    return list(csv.DictReader(io.StringIO(content.decode("utf-8"))))


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue().encode()


def _write(path: Path, content: bytes) -> None:
    """Write a file, unless it is there with this content."""
    if path.is_file() and path.read_bytes() == content:
        return
    with atomic_write(path) as file:
        file.write(content)
