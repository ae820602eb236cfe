"""Measured fitness as people write it: tables that may be incomplete, repeated or wrong, and recordings.

A table has the columns id and fitness, and may have repeats (measurements that the row is the mean of) and failed.
Several rows of one trial are repeats. Whatever cannot be used is named with its line and left out.
"""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.evaluation import FitnessFunction, Outcome, fitness_at_marks, track_configurations
from btr_mjx.gap.data import base_unmeasured, make_recording, read_columns
from btr_mjx.models import base_address, base_model
from btr_mjx.robots import Robot

RECORDING_SUFFIXES = (".csv", ".parquet", ".npz")
"""Files of a recording, in the order in which they are looked for."""

_YES, _NO = ("1", "true", "yes", "x"), ("", "0", "false", "no")
_SHORT = 0.98
"""Part of a trial's duration that its recording must have."""


@dataclass
class Measured:
    """Measurements of one trial.

    Attributes:
      fitness: one or more values, each a row (K,) over the times that were asked for.
      weight: measurements behind each.
      failed: the trial failed.
    """

    fitness: list[np.ndarray] = field(default_factory=list)
    weight: list[int] = field(default_factory=list)
    failed: bool = False

    @property
    def mean(self) -> np.ndarray:
        """(K,) mean over the repeats; NaN for a trial that failed."""
        if self.failed:
            return np.full(1, np.nan)
        return np.average(self.fitness, axis=0, weights=self.weight)

    @property
    def scatter(self) -> float:
        """Standard deviation of a single measurement; NaN where there is one only."""
        last = np.array([row[-1] for row in self.fitness])
        return float(np.std(last, ddof=1)) if len(last) > 1 else math.nan


def read_table_of_fitness(
    path: Path, asked: Sequence[int], limit: float | None
) -> tuple[dict[int, Measured], list[str]]:
    """Measurements in a table by id, and what could not be used, a sentence each.

    Asked for are these ids; a fitness larger than the limit is not plausible.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    rows = list(csv.reader(text.splitlines()))
    head = [name.strip().lower() for name in rows[0]] if rows else []
    if "id" not in head or not {"fitness", "failed"} & set(head):
        return {}, [f"{path}: line 1 has the columns {', '.join(head) or 'none'}; expected id and fitness"]
    found: dict[int, Measured] = {}
    seen: dict[tuple[str, ...], int] = {}
    complaints = []
    for line, cells in enumerate(rows[1:], 2):
        cells = [cell.strip() for cell in cells]
        if not any(cells):
            continue
        key, place = tuple(cells), f"{path}: line {line}"
        if key in seen:
            complaints.append(f"{place} is the same as line {seen[key]}: counted once")
            continue
        seen[key] = line
        row = dict(zip(head, cells, strict=False))
        problem = _use(row, asked, limit, found)
        if problem:
            complaints.append(f"{place}: {problem}")
    for trial, measured in found.items():
        if measured.failed and measured.fitness:
            complaints.append(f"{path}: trial {trial} has a fitness and is marked as failed: it counts as failed")
    return found, complaints


def _use(row: dict[str, str], asked: Sequence[int], limit: float | None, found: dict[int, Measured]) -> str:
    """Add a row to what was found; returns what is wrong with it, or ""."""
    if not row["id"].isdigit() or int(row["id"]) not in asked:
        return f"trial {row['id']!r} was not asked for here (these are {min(asked)} to {max(asked)})"
    failed, text = row.get("failed", "").lower(), row.get("fitness", "")
    if failed not in (*_YES, *_NO):
        return f"failed = {failed!r}: expected 1 or nothing"
    if failed in _YES:
        found.setdefault(int(row["id"]), Measured()).failed = True
        return ""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        return f"fitness {text!r}: expected a number; write 1 in a column failed for a trial that failed"
    if limit is not None and abs(value) > limit:
        return f"fitness {text}: more than {limit:g} is not possible for this robot (speed_limit)"
    repeats = row.get("repeats", "") or "1"
    if not repeats.isdigit() or int(repeats) < 1:
        return f"repeats {repeats!r}: expected a number of measurements, at least 1"
    own = found.setdefault(int(row["id"]), Measured())
    own.fitness.append(np.array([value]))
    own.weight.append(int(repeats))
    return ""


def read_recorded_fitness(
    path: Path, robot: Robot, fitness: FitnessFunction, times: Sequence[float]
) -> tuple[Measured | None, str]:
    """Fitness of a trial from its recording, with the columns of a dataset for `diagnose`; or None and what is wrong.

    Times (K,) are after the first sample [s]; the last one is the trial's end.
    """
    try:
        recording = make_recording(read_columns(path), base_model(robot), str(path), path.stem)
    except InputError as error:
        return None, str(error)
    if base_unmeasured(recording):
        return None, f"{path}: it does not say where the robot was; record the pose of its base, or give the fitness"
    since = recording.time - recording.time[0]
    if since[-1] < _SHORT * times[-1]:
        return None, f"{path}: lasts {since[-1]:.4g} s, a trial takes {times[-1]:g} s"
    rows = [int(np.argmin(np.abs(since - time))) for time in times]
    qpos = recording.qpos[rows]
    if robot.point:
        position, start = track_configurations(robot, qpos), track_configurations(robot, recording.qpos[:1])[0]
    else:
        address = base_address(robot)
        assert address is not None
        position, start = (q[..., address[0] : address[0] + 3] for q in (qpos, recording.qpos[0]))
    work = np.full(len(rows), np.nan)  # forces are not measured
    outcome = Outcome(np.asarray(times, float), start, position, work, qpos, recording.qvel[rows])
    values = np.atleast_1d(fitness_at_marks(outcome, fitness))
    if not np.isfinite(values[-1]):
        return None, f"{path}: the fitness {fitness.name!r} is not defined for this recording"
    return Measured([values], [1]), ""
