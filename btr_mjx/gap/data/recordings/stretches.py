"""Long recordings: all rows are checked, a bounded number of them is kept, in stretches spread evenly over the file.

A search uses windows that last some seconds together, while an hour at 1 kHz takes several times the memory of its
file. Files whose reader can is therefore read in blocks of rows.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.gap.data.columns.model_columns import model_columns, ungroup_columns
from btr_mjx.gap.data.columns.plan import LogOptions, plan_tables, read_log
from btr_mjx.gap.data.files.readers import reader_of
from btr_mjx.gap.data.recordings.clocks import check_time, on_one_clock

MAX_SAMPLES = 100_000
"""Number of samples of a dataset up to which all of them are used."""
KEPT_SAMPLES = 60_000
"""Approximate number of samples that are used of a larger dataset."""
MAX_STRETCHES = 6
"""Largest number of stretches of a recording. A search has at least one window in each, which at 30 joints and 1 kHz
takes a tenth of a gigabyte and of the budget."""
STRETCH_SECONDS = 2.5
"""Shortest stretch [s]: windows last up to 1 s, and need twice their length."""
STRETCH_SAMPLES = 100
"""Fewest samples of a stretch."""

Columns = Mapping[str, np.ndarray]
"""Arrays (K,) by column name."""
Advance = Callable[[int], None]
"""Called with the number of bytes that were read since the last call."""


@dataclass(frozen=True)
class Share:
    """Part of a long recording that is used.

    Attributes:
      rows: number of rows of the recording, or a few more.
      kept: approximate number of samples to keep.
    """

    rows: int
    kept: int


def shares(rows: Sequence[int]) -> list[Share | None]:
    """Parts of recordings that are used, in proportion to their rows; None where everything is used."""
    total = sum(rows)
    if total <= MAX_SAMPLES:
        return [None] * len(rows)
    return [Share(count, max(1, round(KEPT_SAMPLES * count / total))) for count in rows]


def stretch_rows(share: Share, interval: float, from_start: bool = False) -> list[range]:
    """Rows of the stretches of a recording: of equal length, each in the middle of an equal part of the rows.

    Args:
      share: to keep; more where stretches would be shorter than `STRETCH_SECONDS` or `STRETCH_SAMPLES`.
      interval: between two rows [s].
      from_start: one stretch at the beginning instead.
    """
    shortest = max(STRETCH_SECONDS / interval, STRETCH_SAMPLES)
    count = 1 if from_start else int(np.clip(share.kept / shortest + 1e-6, 1, MAX_STRETCHES))
    part = share.rows // count
    length = int(min(max(share.kept / count, shortest), part, MAX_SAMPLES))
    first = 0 if from_start else (part - length) // 2
    return [range(i * part + first, i * part + first + length) for i in range(count)]


def read_stretches(
    paths: Sequence[Path],
    share: Share,
    model: mujoco.MjModel,
    notes: list[str],
    advance: Advance,
    options: LogOptions | None = None,
) -> tuple[list[dict[str, np.ndarray]], float]:
    """Check all rows of a recording and keep some of them.

    Args:
      paths: its files; a single one is read in blocks, where its reader does that.
      share: to keep, see `stretch_rows`.
      model: the recording's model. Activations of its actuators are integrated from the start of the recording, so that
        one stretch is kept there if it has any.
      notes: choices, which share is used, missing values and gaps in time are appended here.
      advance: see `Advance`.
      options: what the dataset says about columns and topics.

    Returns:
      The stretches, and the shift [s] of the times of commands that is left to do.
    """
    options, path = options or LogOptions(), paths[0]
    shift = options.shift
    reader = reader_of(path) if len(paths) == 1 else None
    if reader is not None and reader.blocks is not None:
        found, plan, clock = _Kept(path, share, model), None, (1.0, 0.0)
        for table in reader.blocks(path, advance):
            if plan is None:
                plan = plan_tables([table], model, options, str(path), notes)[0]
                clock = plan.clock(table, notes)
            found.add(ungroup_columns(plan.apply(table, clock), model, str(path)))
    else:
        tables = [ungroup_columns(table, model, str(path)) for table in read_log(paths, model, options, notes, advance)]
        columns, _, shift = on_one_clock(tables, model, options.hold, str(path), notes, shift)
        found = _Kept(path, Share(len(columns["time"]), share.kept), model)
        found.add(columns)
    notes += found.notes()
    pieces = [{name: np.concatenate(parts) for name, parts in kept.items()} for kept in found.pieces if kept]
    return pieces, shift


class _Kept:
    """What is kept of the rows that were checked so far."""

    def __init__(self, path: Path, share: Share, model: mujoco.MjModel) -> None:
        self.model, self.path, self.share = model, path, share
        families = model_columns(model)
        self.needed = {"time", *families["qpos"], *families["qvel"], *families["ctrl"]}
        self.rows: list[range] = []
        self.pieces: list[dict[str, list[np.ndarray]]] = []
        self.time: list[np.ndarray] = []
        self.count = self.bad = 0

    def add(self, columns: Columns) -> None:
        """Check the next rows, and keep those that are in a stretch."""
        time, first = columns["time"], self.count
        self.count += len(time)
        if not self.rows:
            interval = float(np.nanmedian(np.diff(time))) if len(time) > 1 else 0.0
            interval = interval if interval > 0 else STRETCH_SECONDS
            self.rows = stretch_rows(self.share, interval, from_start=self.model.na > 0)
            self.pieces = [{} for _ in self.rows]
        whole = [np.isfinite(values) for name, values in columns.items() if name in self.needed]
        self.bad += int((~np.all(whole, axis=0)).sum())
        last = self.time[-1][-1:] if self.time else time[:0]
        own = time[np.isfinite(time)]
        check_time(np.concatenate([last, own]), f"{self.path}, rows {first + 1} to {self.count}", first - len(last))
        self.time += [own] if len(own) else []
        for rows, kept in zip(self.rows, self.pieces, strict=True):
            part = slice(max(rows.start - first, 0), max(rows.stop - first, 0))
            if part.start < min(part.stop, len(time)):
                for name, values in columns.items():
                    kept.setdefault(name, []).append(values[part].copy())

    def notes(self) -> list[str]:
        """What is used, and what is wrong elsewhere."""
        time = np.concatenate(self.time)
        kept = sum(len(part) for parts in self.pieces for part in parts.get("time", ()))
        where = f"in {len(self.rows)} stretches spread evenly over {np.ptp(time):.1f} s"
        if self.model.na:
            where = "from the beginning on, as activations of actuators are known there"
        lines = [
            f"{self.path.name}: {kept} of {self.count} samples ({kept / self.count:.1%}) are used, {where}; time "
            "stamps and missing values were checked in all rows"
        ]
        if self.bad:
            lines.append(f"{self.path.name}: {self.bad} of all rows have missing values")
        steps = np.diff(time)
        gaps = np.flatnonzero(steps > 3 * np.median(steps))
        if len(gaps):
            lines.append(
                f"{self.path.name}: {len(gaps)} gaps of more than three intervals in all rows, the longest of "
                f"{steps[gaps].max():.4g} s"
            )
        return lines
