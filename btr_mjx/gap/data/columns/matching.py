"""Columns of a log matched to joints and actuators of a model, by name.

Case, separators, units and words for the quantity do not count: "q_hip [deg]", "hip.position", "joint_states/hip/pos"
and "HipPos" all are the position of the joint "hip", "hip_cmd" and "des_pos_hip" the command of its actuator. Every
word of a name has to be known, so that "hip_temperature" is none of them. Words that are not, such as the robot's name
in "left_arm/q_hip", are left out where all names match without them and no others could be left out instead. Columns
with numbers instead of names are taken in the order of the model, if there are as many. Whatever stays ambiguous is
asked for.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import model_columns, sensor_parts
from btr_mjx.gap.data.columns.one_column import (
    Candidates,
    ModelNames,
    Words,
    common_words,
    fillers,
    match_numbers,
    match_one,
    without,
)
from btr_mjx.gap.data.columns.remedy import NO_FILE, Answer, quoted
from btr_mjx.gap.data.columns.units import stated_unit
from btr_mjx.gap.data.columns.whole_groups import keep_whole_groups
from btr_mjx.gap.data.columns.words import TIME, words
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import nearest_names, part_names

Tables = Sequence[tuple[str, Sequence[str]]]
"""Label and column names of each table of a recording."""
_TRIED = 8
"""Most sets of unknown words that are tried without."""


@dataclass(frozen=True)
class Matched:
    """Which column of a log is which column of a model.

    Attributes:
      names: column of the model, by number of the table and name in the table.
      notes: choices that were made.
    """

    names: Mapping[tuple[int, str], str]
    notes: Sequence[str] = ()


def match_columns(
    tables: Tables,
    model: mujoco.MjModel,
    given: Mapping[str, str],
    where: str,
    answer: Answer = NO_FILE,
    labelled: bool = False,
    forces: bool = False,
) -> Matched:
    """Match the columns of the tables of one recording.

    Names that are `given`, by name in the log, win. Labels of the tables count if `labelled`: they say what these hold.
    With `forces`, measured forces of the actuators are their commands, see `measured_forces`.

    Returns:
      The matches. Columns of the log that are none of the model's are left out.

    Raises:
      InputError: two columns that could be the same one of the model, or a name in `given` that is none.
    """
    families = model_columns(model)
    exact = {"time", "qpos", "qvel", "ctrl", *(["force"] if forces else [])}.union(*families.values())
    exact |= {f"{kind}/{name}" for kind in ("qpos", "qvel") for name in part_names(model, "joint")}
    _check_given(given, tables, exact, where)
    names = ModelNames.of(model, forces)

    def matched(filler: Words) -> Matched:
        return _match(tables, names, given, exact, filler, where, answer, labelled)

    best, needed = matched(()), {*families["qpos"], *families["ctrl"]}
    unused = [column for i, (_, own) in enumerate(tables) for column in own if (i, column) not in best.names]
    said = {column: words(stated_unit(column)[0]) for column in unused}
    complete = []
    if needed - set(best.names.values()):
        count = Counter(filler for own in said.values() for filler in fillers(own, names))
        for filler in [filler for filler, _ in count.most_common(_TRIED) if filler]:
            found = matched(filler)
            left = {column for _, column in found.names}
            whole = all(c in left for c, own in said.items() if without(own, filler) != own)
            if len(found.names) > len(best.names) and (whole or needed <= set(found.names.values())):
                complete.append((filler, found))
    if len(complete) == 1:
        filler, best = complete[0]
        best = Matched(best.names, (*best.notes, f"{' '.join(filler)!r} in names of columns does not count"))
    return best


def _match(
    tables: Tables,
    names: ModelNames,
    given: Mapping[str, str],
    exact: set[str],
    filler: Words,
    where: str,
    answer: Answer,
    labelled: bool,
) -> Matched:
    """The matches where the words of `filler` may be left out."""
    finds, notes = Candidates(), list[str]()
    found: dict[tuple[int, str], str] = {}
    vectors = [(name, own) for name, own in sensor_parts(names.model).items() if len(own) > 1]
    numbered = {f"sensor/{name}/{k}": column for name, own in vectors for k, column in enumerate(own)}
    for i, (label, columns) in enumerate(tables):
        common = common_words([c for c in columns if c not in exact])
        for column in columns:
            if column in given:
                found[i, column] = names.driving(given[column]) or given[column]
            elif column.startswith("sensor/"):
                found[i, column] = numbered.get(column, column)
            elif column in exact:
                if (target := names.driving(column)) is not None:
                    found[i, column] = target
            elif (sensor := names.sensors.get(words(stated_unit(column)[0]))) is not None:
                finds.ranked[sensor].append((3, i, column))
            elif column.split("/", 1)[0] not in ("qpos", "qvel", "ctrl", "force"):  # a misspelt name stays an error
                match_one(i, column, words(label) if labelled else (), common, filler, names, finds)
        _match_time(i, columns, found, notes)
    taken = set(found.values())
    match_numbers(names, finds, taken, notes)
    for target, ranked in sorted(finds.ranked.items()):
        if target in taken:
            continue
        best = max(rank for rank, _, _ in ranked)
        chosen = [(i, column) for rank, i, column in ranked if rank == best]
        if len(chosen) > 1 and target.startswith("sensor/"):
            finds.undecided[(target[7:].rpartition("/")[0],)] += [column for _, column in chosen]
            continue
        if len(chosen) > 1:
            these = [repr(column) for _, column in chosen]
            line = f"{quoted(chosen[0][1])} = {quoted(target)}  # or {listed(these[1:])}"
            raise answer.error(f"{where}: {listed(these)} may all be {target!r}", [line])
        found[chosen[0]] = target
        if best == 1 and target.startswith("ctrl/"):
            notes.append(f"no column is named a command of {target[5:]!r}; {chosen[0][1]!r} is taken as its command")
    keep_whole_groups(found, names.model, notes)
    notes += names.imu.lacking([c for i, (_, own) in enumerate(tables) for c in own if (i, c) not in found])
    for sensors, columns in finds.undecided.items():
        notes.append(
            f"columns without a use: {listed(columns)}: may be of {' or '.join(sensors)}; say which in [columns]"
        )
    spoken = [f"{column} = {target}" for (_, column), target in found.items() if column != target]
    return Matched(found, [*notes, f"columns matched by name: {listed(spoken, 40)}"] if spoken else notes)


def _check_given(given: Mapping[str, str], tables: Tables, exact: set[str], where: str) -> None:
    known = [column for _, columns in tables for column in columns]
    for column, target in given.items():
        if target not in exact and not target.startswith("sensor/"):
            near = nearest_names(target, sorted(exact))
            raise InputError(f"{where}: [columns] {column!r} = {target!r}: is no column of the model; nearest: {near}")
        if column not in known:
            near = nearest_names(column, known)
            raise InputError(f"{where}: [columns] {column!r}: there is no such column; nearest in the file: {near}")


def _match_time(i: int, columns: Sequence[str], names: dict[tuple[int, str], str], notes: list[str]) -> None:
    """Find the column of time, unless one is named already."""
    if any(names.get((i, column)) == "time" for column in columns):
        return
    found = []
    for place, column in enumerate(columns):
        named = [word for word in words(stated_unit(column)[0]) if word not in ("header", "s", "sec", "ros", "log")]
        if named and (i, column) not in names and named[-1] in TIME:
            found.append((len(named), TIME.index(named[-1]), place, column))
    if found:
        column = min(found)[-1]
        names[i, column] = "time"
        if len(found) > 1:
            others = listed([one[-1] for one in sorted(found)[1:]], quotes=True)
            notes.append(f"time is column {column!r}, not {others}")
