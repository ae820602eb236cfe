"""From the tables of a log to the columns of a model: which column is which, in which unit, from which time on."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.leftover import with_leftovers
from btr_mjx.gap.data.columns.matching import match_columns
from btr_mjx.gap.data.columns.remedy import NO_FILE, Answer
from btr_mjx.gap.data.columns.required import check_matched
from btr_mjx.gap.data.columns.units import TIME_UNITS, ColumnUnit, conversion, stated_unit, to_seconds
from btr_mjx.gap.data.files.readers import read_file
from btr_mjx.gap.data.files.table import LogTable
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import nearest_names


@dataclass(frozen=True)
class LogOptions:
    """What a dataset says about its logs.

    Attributes:
      columns: names of the model by name in the log.
      topics: topics by key of `ros_bag.TOPICS`.
      unmeasured: names of joints that are said to have no encoder.
      units: units by name in the log.
      answer: where a user says what columns are.
      forces: whether measured forces of the actuators drive the model, instead of commands.
      hold: hold commands of a slower clock between their samples, instead of interpolating them.
      shift: seconds that are added to the times of commands.
      sources: filled with names of the log by name of the model when columns are matched.
      factors: filled with factors of what was converted, by name of the model.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    unmeasured: Collection[str] = ()
    units: Mapping[str, ColumnUnit] = field(default_factory=dict)
    answer: Answer = NO_FILE
    hold: bool = True
    shift: float = 0.0
    forces: bool = False
    sources: dict[str, str] = field(default_factory=dict)
    factors: dict[str, float] = field(default_factory=dict)


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

    def clock(self, table: LogTable, notes: list[str]) -> tuple[float, float]:
        """Factor and origin of the table's times, see `units.to_seconds`; notes are appended."""
        return to_seconds(table.columns[self.time[0]], self.time[1], notes)

    def apply(self, table: LogTable, clock: tuple[float, float]) -> dict[str, np.ndarray]:
        """Columns of the model from those of the table; refuses a column that holds something else than numbers."""
        found = {}
        for name, target in self.names.items():
            if name in table.text:
                raise InputError(table.text[name])
            values = table.columns[name]
            if target == "time":
                found[target] = values if clock == (1.0, 0.0) else (values - clock[1]) * clock[0]
            else:
                factor = self.factors.get(target, 1.0)
                found[target] = values if factor == 1 else values * factor
        return found


def plan_tables(
    tables: Sequence[LogTable], model: mujoco.MjModel, options: LogOptions, where: str, notes: list[str]
) -> list[Plan]:
    """Match the tables of a recording to a model.

    Returns:
      A plan for each table; tables without a column of the model have no names in theirs.

    Raises:
      InputError: columns that are missing or ambiguous, or a unit that does not fit.
    """
    named = [(table.label, list(table.columns)) for table in tables]
    known = [name for _, names in named for name in names]
    for name in options.units:
        if name not in known:
            near = nearest_names(name, known)
            raise InputError(f"{where}: [units] {name!r}: there is no such column; nearest in the file: {near}")
    units = {name: unit for table in tables for name, unit in table.units.items()}
    units |= {name: unit.text for name, unit in options.units.items()}
    matched = match_columns(
        named, model, options.columns, where, options.answer, labelled=len(tables) > 1, forces=options.forces
    )
    if not options.forces:
        matched = with_leftovers(matched, named, model, options.unmeasured, units)
    check_matched(matched, named, model, where, options.unmeasured, options.answer, units)
    notes += matched.notes
    options.sources.update({target: name for (_, name), target in matched.names.items()})
    return [_plan(i, table, matched.names, model, options, where, notes) for i, table in enumerate(tables)]


def _plan(
    i: int,
    table: LogTable,
    matched: Mapping[tuple[int, str], str],
    model: mujoco.MjModel,
    options: LogOptions,
    where: str,
    notes: list[str],
) -> Plan:
    own = {name: target for (number, name), target in matched.items() if number == i}
    if set(own.values()) <= {"time"}:
        return Plan({}, {}, ("", None))
    factors, told = dict[str, float](), list[str]()
    time: tuple[str, str | None] = ("", None)
    for name, target in own.items():
        said = table.units.get(name) or stated_unit(name)[1]
        unit = options.units.get(name) or (ColumnUnit.of(said) if said else None)
        factor = conversion(target, unit, model, f"{where}: column {name!r}") if unit else 1.0
        if target == "time":
            if unit and unit.text not in TIME_UNITS:
                raise InputError(
                    f"{where}: column {name!r}: is in {unit.text}; expected one of {', '.join(TIME_UNITS)}"
                )
            time = name, unit.text if unit else None
        elif factor != 1:
            factors[target] = factor
            told.append(f"{name} from {unit.text if unit else ''}")
    options.factors.update(factors)
    if told:
        notes.append(f"converted to SI units: {listed(told)}")
    unused = [name for name in table.columns if name not in own]
    if unused:
        notes.append(f"columns without a use: {listed(unused)}")
    return Plan(own, factors, time)


def read_log(
    paths: Sequence[Path],
    model: mujoco.MjModel,
    options: LogOptions,
    notes: list[str],
    advance: Callable[[int], None],
) -> list[dict[str, np.ndarray]]:
    """Read the files of one recording; `advance` is called with numbers of bytes that were read.

    Returns:
      Columns of the model by name, for each table with a clock of its own; "time" in [s].
    """
    tables: list[LogTable] = []
    for path in paths:
        tables += read_file(path, options.topics, model)
        advance(path.stat().st_size)
    where = ", ".join(map(str, paths))
    notes += dict.fromkeys(note for table in tables for note in table.notes)
    plans = plan_tables(tables, model, options, where, notes)
    used = [(table, plan) for table, plan in zip(tables, plans, strict=True) if plan.names]
    own: list[str] = []
    clocks = [plan.clock(table, own) for table, plan in used]
    notes += dict.fromkeys(own)
    # Tables share an origin: that of the clock which begins first.
    origin, scale = min(((start * factor, factor) for factor, start in clocks), default=(0.0, 1.0))
    starts = [start if factor == scale and start * factor == origin else origin / factor for factor, start in clocks]
    return [
        plan.apply(table, (factor, start))
        for (table, plan), (factor, _), start in zip(used, clocks, starts, strict=True)
    ]
