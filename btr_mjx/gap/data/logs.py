"""Logs of any format: their tables, and the columns of a model that follow from them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import polars as pl

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import numbers_of, read_columns
from btr_mjx.gap.data.formats.delimited import read_text_table
from btr_mjx.gap.data.formats.hdf5 import read_hdf5
from btr_mjx.gap.data.formats.ros_bag import is_ros_folder, read_ros
from btr_mjx.gap.data.formats.sysid import is_time_series, time_series_table
from btr_mjx.gap.data.formats.torch_file import read_torch
from btr_mjx.gap.data.names.matching import match_columns
from btr_mjx.gap.data.names.remedy import NO_FILE, Answer
from btr_mjx.gap.data.names.required import check_matched
from btr_mjx.gap.data.names.units import conversion, stated_unit, to_seconds
from btr_mjx.gap.data.tables import LogTable, log_table
from btr_mjx.models import nearest_names
from btr_mjx.runs import read_arrays, read_table

TEXT = (".csv", ".tsv", ".txt", ".dat", ".log")
HDF5 = (".h5", ".hdf5", ".hdf")
ROS = (".mcap", ".db3", ".bag")
LOG_SUFFIXES = (*TEXT, ".parquet", ".npz", *HDF5, *ROS, ".pt")
"""Suffixes of the files that can be recordings."""


@dataclass(frozen=True)
class LogOptions:
    """What a dataset says about its logs.

    Attributes:
      columns: names of the model by name in the log.
      topics: topics by key of `formats.ros_bag.TOPICS`.
      unmeasured: names of joints that are said to have no encoder.
      units: units by name in the log.
      answer: where a user says what columns are.
      sources: filled with names of the log by name of the model when columns are matched.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    unmeasured: Collection[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    answer: Answer = NO_FILE
    sources: dict[str, str] = field(default_factory=dict)


def is_log(path: Path) -> bool:
    """Whether a path has the form of a recording."""
    return (path.is_file() and path.suffix.lower() in LOG_SUFFIXES) or is_ros_folder(path)


def read_tables(path: Path, options: LogOptions, model: mujoco.MjModel) -> list[LogTable]:
    """Read the tables of a log.

    Args:
      path: a file with one of `LOG_SUFFIXES`, or a rosbag2 folder.
      options: what the dataset says.
      model: the recording's model.

    Raises:
      InputError: another suffix, or invalid content.
      DamagedFile: the file does not parse.
      OSError: the file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix in ROS or is_ros_folder(path):
        return read_ros(path, options.topics, model)
    if suffix in HDF5:
        return read_hdf5(path)
    if suffix == ".pt":
        return [read_torch(path)[0]]
    if suffix == ".npz":
        arrays = read_arrays(path)
        if is_time_series(arrays):
            return [time_series_table(path, arrays)]
        return [LogTable(path.stem, read_columns(path))]
    if suffix == ".parquet":
        frame = read_table(path.with_suffix(suffix) if path.suffix == suffix else path)
        return [_frame_table(path, frame, {})]
    if suffix in TEXT:
        return [_text_table(path)]
    raise InputError(f"{path}: a recording is a {', '.join(LOG_SUFFIXES)} file, got {path.suffix or 'no suffix'!r}")


def _text_table(path: Path) -> LogTable:
    frame, dialect = read_text_table(path)
    return _frame_table(path, frame, dialect.stated_units)


def _frame_table(path: Path, frame: pl.DataFrame, units: Mapping[str, str]) -> LogTable:
    """The table of a frame of numbers and of lists of numbers."""
    if frame.is_empty():
        raise InputError(f"{path}: it holds no rows")
    arrays: dict[str, np.ndarray] = {}
    text: dict[str, str] = {}
    for name in frame.columns:
        series, kind = frame[name], frame[name].dtype
        inner = kind.inner if isinstance(kind, pl.List | pl.Array) else None
        try:
            if isinstance(inner, pl.DataType) and inner.is_numeric():
                arrays[name.strip()] = _stacked(path, series)
            else:
                arrays[name.strip()] = numbers_of(path, series)
        except InputError as error:
            arrays[name.strip()] = np.full(len(frame), np.nan)
            text[name.strip()] = str(error)
    table = log_table(path, path.stem, arrays, None, units)
    return LogTable(table.label, table.columns, table.units, (), text)


def _stacked(path: Path, series: pl.Series) -> np.ndarray:
    widths = series.list.len() if isinstance(series.dtype, pl.List) else pl.Series([1])
    if widths.n_unique() > 1 or series.null_count():
        raise InputError(f"{path}: column {series.name!r} holds lists of different lengths; expected equal ones")
    return np.array(series.to_list(), float)


@dataclass(frozen=True)
class Plan:
    """How the columns of a table become those of a model.

    Attributes:
      names: column of the model by column of the table.
      factors: to the model's unit, by column of the model; 1 where absent.
      time: the table's column of time, and its stated unit.
    """

    names: Mapping[str, str]
    factors: Mapping[str, float]
    time: tuple[str, str | None]

    def apply(self, columns: Mapping[str, np.ndarray], clock: tuple[float, float]) -> dict[str, np.ndarray]:
        """Columns of the model from those of the table; `clock` is a factor and an origin, see `units.to_seconds`."""
        found = {}
        for name, values in columns.items():
            target = self.names.get(name)
            if target == "time":
                found[target] = values if clock == (1.0, 0.0) else (values - clock[1]) * clock[0]
            elif target is not None:
                factor = self.factors.get(target, 1.0)
                found[target] = values if factor == 1 else values * factor
        return found


def plan_tables(
    tables: Sequence[tuple[str, Sequence[str], Mapping[str, str]]],
    model: mujoco.MjModel,
    options: LogOptions,
    where: str,
    notes: list[str],
) -> list[Plan]:
    """Match the tables of a recording to a model.

    Args:
      tables: label, names and stated units of the columns of each table.
      model: the recording's model.
      options: what the dataset says.
      where: file, for messages.
      notes: choices are appended here.

    Returns:
      A plan for each table; tables without a column of the model have no names in theirs.

    Raises:
      InputError: columns that are missing or ambiguous, or a unit that does not fit.
    """
    named = [(label, names) for label, names, _ in tables]
    known = [name for _, names in named for name in names]
    for name in options.units:
        if name not in known:
            near = nearest_names(name, known)
            raise InputError(f"{where}: [units] {name!r}: there is no such column; nearest in the file: {near}")
    matched = match_columns(named, model, options.columns, where, options.answer, labelled=len(tables) > 1)
    check_matched(matched, named, model, where, options.unmeasured, options.answer)
    notes += matched.notes
    options.sources.update({target: name for (_, name), target in matched.names.items()})
    plans = []
    for i, (_, names, units) in enumerate(tables):
        own = {name: target for (table, name), target in matched.names.items() if table == i}
        if set(own.values()) <= {"time"}:
            own = {}
        factors, told = {}, []
        time: tuple[str, str | None] = ("", None)
        for name, target in own.items():
            unit = options.units.get(name) or units.get(name) or stated_unit(name)[1]
            factor = conversion(target, unit, model, f"{where}: column {name!r}") if unit else 1.0
            if target == "time":
                time = name, unit
            elif unit:
                factors[target] = factor
                told += [f"{name} from {unit}"] if factors[target] != 1 else []
        if told:
            notes.append(f"converted to SI units: {', '.join(told[:20])}")
        unused = [name for name in names if name not in own] if own else []
        if unused:
            notes.append(f"columns without a use: {', '.join(unused[:8])}{', ...' if len(unused) > 8 else ''}")
        plans.append(Plan(own, factors, time))
    return plans


def read_log(
    paths: Sequence[Path],
    model: mujoco.MjModel,
    options: LogOptions,
    notes: list[str],
    advance: Callable[[int], None] = lambda count: None,
) -> list[dict[str, np.ndarray]]:
    """Read the files of one recording.

    Args:
      paths: its files.
      model: the recording's model.
      options: what the dataset says.
      notes: choices and conversions are appended here.
      advance: called with numbers of bytes that were read.

    Returns:
      Columns of the model by name, for each table with a clock of its own; "time" in [s].

    Raises:
      InputError: see `read_tables` and `plan_tables`.
      DamagedFile: a file does not parse.
      OSError: a file cannot be read.
    """
    tables: list[LogTable] = []
    for path in paths:
        tables += read_tables(path, options, model)
        advance(path.stat().st_size)
    where = ", ".join(map(str, paths))
    notes += dict.fromkeys(note for table in tables for note in table.notes)
    plans = plan_tables([(t.label, list(t.columns), t.units) for t in tables], model, options, where, notes)
    used = [(table, plan) for table, plan in zip(tables, plans, strict=True) if plan.names]
    for table, plan in used:
        for name in plan.names:
            if name in table.text:
                raise InputError(table.text[name])
    own: list[str] = []
    clocks = [to_seconds(table.columns[plan.time[0]], plan.time[1], own) for table, plan in used]
    notes += dict.fromkeys(own)
    origin, scale = min(((start * factor, factor) for factor, start in clocks), default=(0.0, 1.0))
    starts = [start if factor == scale and start * factor == origin else origin / factor for factor, start in clocks]
    return [
        plan.apply(table.columns, (factor, start))
        for (table, plan), (factor, _), start in zip(used, clocks, starts, strict=True)
    ]
