"""Long recordings: all rows are checked, a bounded number of them is kept, in stretches spread evenly over the file.

A search uses windows that last some seconds together, while an hour at 1 kHz takes several times the memory of its
file. A CSV file is therefore parsed in blocks of rows, and a Parquet file column by column.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import polars as pl

from btr_mjx.errors import DamagedFile
from btr_mjx.gap.data.clocks import on_one_clock
from btr_mjx.gap.data.columns import control_columns, numbers_of, state_columns, ungroup_columns
from btr_mjx.gap.data.formats.delimited import Dialect, parse_rows, read_dialect
from btr_mjx.gap.data.formats.hdf5 import count_hdf5_rows
from btr_mjx.gap.data.formats.ros_bag import count_messages, is_ros_folder
from btr_mjx.gap.data.logs import HDF5, ROS, TEXT, LogOptions, Plan, plan_tables, read_log
from btr_mjx.gap.data.names.units import to_seconds
from btr_mjx.gap.data.samples import MAX_MISSING_ROWS, check_time

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
BLOCK_BYTES = 1 << 24
"""Bytes of a CSV file that are parsed at once."""

_READ_ERRORS = Exception, pl.exceptions.PanicException
"""What polars' readers raise: they have no common base class."""

Columns = Mapping[str, np.ndarray]
"""Arrays (K,) by column name."""
Advance = Callable[[int], None]
"""Called with the number of bytes that were read since the last call."""


def count_rows(path: Path) -> int:
    """Number of rows of a recording, or one more; 0 for a file that cannot be read."""
    if is_ros_folder(path) or path.suffix.lower() in ROS:
        return count_messages(path)
    if not path.is_file():
        return 0
    try:
        match path.suffix.lower():
            case suffix if suffix in HDF5:
                return count_hdf5_rows(path)
            case suffix if suffix in TEXT:
                with path.open("rb") as file:
                    return sum(block.count(b"\n") for block in iter(lambda: file.read(BLOCK_BYTES), b""))
            case ".parquet":
                return int(pl.scan_parquet(path).select(pl.len()).collect().item())
            case ".npz":
                with np.load(path, allow_pickle=False) as archive:
                    return len(archive["time"])
    except _READ_ERRORS:  # the reader of the file says what is wrong with it
        return 0
    return 0


@dataclass(frozen=True)
class Share:
    """Part of a long recording that is used.

    Attributes:
      rows: number of rows of the recording, or one more.
      kept: approximate number of samples to keep.
    """

    rows: int
    kept: int


def shares(rows: Sequence[int]) -> list[Share | None]:
    """The part of each recording of a dataset that is used.

    Args:
      rows: number of rows of each recording.

    Returns:
      Shares in proportion to the rows; None for recordings of which everything is used.
    """
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
    paths: Path | Sequence[Path],
    share: Share,
    model: mujoco.MjModel,
    notes: list[str],
    advance: Advance,
    options: LogOptions | None = None,
    hold: bool = True,
) -> list[Columns]:
    """Check all rows of a recording and keep some of them.

    Args:
      paths: its file or files. A single text table is read in blocks, a single Parquet file column by column, the
        others as a whole.
      share: to keep, see `stretch_rows`.
      model: the recording's model. Activations of its actuators are integrated from the start of the recording, so that
        one stretch is kept there if it has any.
      notes: choices, which share is used, missing values and gaps in time are appended here.
      advance: see `Advance`.
      options: what the dataset says about columns and topics.
      hold: hold commands of a slower clock between their samples, instead of interpolating them.

    Returns:
      The columns of each stretch, in the order of time.

    Raises:
      InputError: see `logs.read_log` and `samples.check_time`.
      DamagedFile: the content does not parse.
      OSError: the file cannot be read.
    """
    options = options or LogOptions()
    paths = [paths] if isinstance(paths, Path) else list(paths)
    path, suffix = paths[0], paths[0].suffix.lower() if len(paths) == 1 else ""
    if suffix in TEXT or suffix == ".parquet":
        found = _Collected(path, share, model)
        (_collect_text if suffix in TEXT else _collect_parquet)(path, found, options, notes, advance)
    else:
        tables = [ungroup_columns(table, model, str(path)) for table in read_log(paths, model, options, notes, advance)]
        columns, _ = on_one_clock(tables, model, hold, str(path), notes)
        found = _Collected(path, Share(len(columns["time"]), share.kept), model)
        found.add(0, columns)
    notes += found.notes()
    return found.stretches()


class _Collected:
    """What is kept of the rows that were checked so far."""

    def __init__(self, path: Path, share: Share, model: mujoco.MjModel) -> None:
        self.model, self._path, self._share = model, path, share
        self._needed = {"time", *control_columns(model), *(c for names in state_columns(model) for c in names)}
        self._rows: list[range] = []
        self._pieces: list[dict[str, list[np.ndarray]]] = []
        self._bad = np.zeros(share.rows + 1, bool)
        self._time: list[np.ndarray] = []

    def add(self, first: int, columns: Columns, checked: int = 0, known: Sequence[str] = ()) -> None:
        """Check and keep a block.

        Args:
          first: row of its first sample.
          columns: of the block, with the time.
          checked: number of its first samples that an earlier block had.
          known: columns that an earlier block had.
        """
        time = columns["time"]
        where = f"{self._path}, rows {first + 1} to {first + len(time)}"
        if not self._rows:
            interval = float(np.nanmedian(np.diff(time))) if len(time) > 1 else 0.0
            self._rows = stretch_rows(
                self._share, interval if interval > 0 else STRETCH_SECONDS, from_start=self.model.na > 0
            )
            self._pieces = [{} for _ in self._rows]
        new = [name for name in columns if name not in known]
        for name in new:
            if name in self._needed:
                self._bad[first : first + len(time)] |= ~np.isfinite(columns[name])
        if "time" in new:
            check_time(time[np.isfinite(time)], where, first)
            self._time.append(time[checked:])
        for rows, kept in zip(self._rows, self._pieces, strict=True):
            own = slice(max(rows.start - first, checked), max(rows.stop - first, checked))
            if own.start < min(own.stop, len(time)):
                for name in new:
                    kept.setdefault(name, []).append(columns[name][own].copy())

    def stretches(self) -> list[Columns]:
        return [{name: np.concatenate(parts) for name, parts in kept.items()} for kept in self._pieces if kept]

    def notes(self) -> list[str]:
        time = np.concatenate(self._time)
        kept = sum(len(part) for parts in self._pieces for part in parts.get("time", ()))
        where = f"in {len(self._rows)} stretches spread evenly over {np.ptp(time):.1f} s"
        if self.model.na:
            where = "from the beginning on, as activations of actuators are known there"
        lines = [
            f"{self._path.name}: {kept} of {len(time)} samples ({kept / len(time):.1%}) are used, {where}; time stamps "
            "and missing values were checked in all rows"
        ]
        if self._bad.any():
            lines.append(f"{self._path.name}: {int(self._bad.sum())} of all rows have missing values")
        steps = np.diff(time[np.isfinite(time)])
        gaps = np.flatnonzero(steps > 3 * np.median(steps))
        if len(gaps):
            k = int(gaps[np.argmax(steps[gaps])])
            lines.append(
                f"{self._path.name}: {len(gaps)} gaps of more than three intervals in all rows, the longest of "
                f"{steps[k]:.4g} s"
            )
        return lines


def _collect_text(path: Path, found: _Collected, options: LogOptions, notes: list[str], advance: Advance) -> None:
    dialect = read_dialect(path)
    names = [name for name in dialect.names if name]
    plan = plan_tables([(path.stem, names, dialect.stated_units)], found.model, options, str(path), notes)[0]
    first, tail, clock = 0, None, None
    for frame in _text_blocks(path, dialect, advance):
        raw = {name: numbers_of(path, frame[name], first) for name in frame.columns if name in plan.names}
        clock = clock or to_seconds(raw[plan.time[0]], plan.time[1], notes)
        columns = ungroup_columns(plan.apply(raw, clock), found.model, str(path))
        joined = columns
        if tail is not None:
            joined = {name: np.concatenate([tail[name], values]) for name, values in columns.items()}
        overlap = len(joined["time"]) - len(frame)
        found.add(first - overlap, joined, overlap)
        tail = {name: values[-MAX_MISSING_ROWS:] for name, values in joined.items()}
        first += len(frame)


def _text_blocks(path: Path, dialect: Dialect, advance: Advance) -> Iterator[pl.DataFrame]:
    """Frames of whole lines of a text table."""
    with path.open("rb") as file:
        file.seek(dialect.start)
        rest = b""
        while block := file.read(BLOCK_BYTES):
            advance(len(block))
            cut = block.rfind(b"\n") + 1
            lines, rest = rest + block[:cut], block[cut:] if cut else rest + block
            if lines.strip():
                yield parse_rows(path, dialect, lines)
        if rest.strip():
            yield parse_rows(path, dialect, rest)


def _collect_parquet(path: Path, found: _Collected, options: LogOptions, notes: list[str], advance: Advance) -> None:
    names = _column_names(path)
    shown = {name.strip(): name for name in names}
    plan: Plan = plan_tables([(path.stem, list(shown), {})], found.model, options, str(path), notes)[0]
    size = path.stat().st_size // len(names)
    stamps = numbers_of(path, _parquet_column(path, shown[plan.time[0]]))
    clock = to_seconds(stamps, plan.time[1], notes)
    time = plan.apply({plan.time[0]: stamps}, clock)
    found.add(0, time)
    for name in plan.names:
        if name != plan.time[0]:
            values = numbers_of(path, _parquet_column(path, shown[name]))
            columns = ungroup_columns(plan.apply({name: values}, clock), found.model, str(path))
            found.add(0, time | columns, known=("time",))
        advance(size)


def _column_names(path: Path) -> list[str]:
    try:
        return list(pl.read_parquet_schema(path))
    except _READ_ERRORS as error:
        raise DamagedFile(f"{path}: not a readable parquet table ({error})") from error


def _parquet_column(path: Path, name: str) -> pl.Series:
    try:
        return pl.read_parquet(path, columns=[name], memory_map=False)[name]
    except _READ_ERRORS as error:
        raise DamagedFile(f"{path}: column {name!r} is not readable ({error})") from error
