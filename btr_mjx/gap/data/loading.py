"""Recordings of a dataset.toml: the rows [[recording]], their files and models, and what all of them say together."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import model_columns
from btr_mjx.gap.data.columns.plan import LogOptions, read_log
from btr_mjx.gap.data.columns.remedy import Answer
from btr_mjx.gap.data.columns.required import CommandsMissing
from btr_mjx.gap.data.columns.units import UNITS, ColumnUnit
from btr_mjx.gap.data.control import Control, Interpolation
from btr_mjx.gap.data.dataset import DATASET_FILE, Dataset, read_header
from btr_mjx.gap.data.files.readers import count_rows, is_log
from btr_mjx.gap.data.files.ros_bag import TOPICS
from btr_mjx.gap.data.lists import listed
from btr_mjx.gap.data.measured_forces import driven_by_forces
from btr_mjx.gap.data.model_file import load_model
from btr_mjx.gap.data.recordings.held import bends, stairs
from btr_mjx.gap.data.recordings.recording import (
    MIN_SAMPLES,
    EmptyRecording,
    Recording,
    base_unmeasured,
    make_recordings,
)
from btr_mjx.gap.data.recordings.splits import assign_splits, split_parts
from btr_mjx.gap.data.recordings.stretches import Advance, Share, read_stretches, shares
from btr_mjx.gap.data.recordings.velocities import estimate_velocity, velocity_lag
from btr_mjx.models import difference, part_names, set_values
from btr_mjx.runs import check_keys, file_inside, is_number, toml_rows, toml_section

ReadProgress = Callable[[int, int], None]
"""Called with the bytes that were read so far, and those of all files."""


def load(folder: str | Path, progress: ReadProgress | None = None) -> Dataset:
    """Read a dataset.

    Args:
      folder: the folder, or its dataset.toml.
      progress: called while recordings are read.

    Returns:
      The dataset, with all recordings loaded, or stretches of them where they have more than
      `stretches.MAX_SAMPLES` samples together; a note says which share is used.

    Raises:
      InputError: invalid content; one line with the value, its place and the remedy.
      DamagedFile: a file that does not parse.
      OSError: a file that cannot be read.
    """
    head, table = read_header(folder)
    return load_table(head, table, head.folder / DATASET_FILE, progress)


def load_table(
    head: Dataset, table: Mapping[str, Any], path: Path, progress: ReadProgress | None = None, text: str = ""
) -> Dataset:
    """Read the recordings of a dataset whose header was read, see `load`; `text` is its dataset.toml without a file.

    Where no commands were logged, but the forces of the actuators, these drive the model.
    """
    try:
        return _load_table(head, table, path, progress, text)
    except CommandsMissing as error:
        if head.control.measured:
            raise
        model = driven_by_forces(head.model)
        note = f"{error}, but forces of the actuators: they drive the model, and controllers may be unknown"
        head = replace(head, model=model, forces=True, notes=(*head.notes, note))
        return _load_table(head, table, path, progress, text)


def _load_table(
    head: Dataset, table: Mapping[str, Any], path: Path, progress: ReadProgress | None, text: str
) -> Dataset:
    notes, listed_rows = list(head.notes), toml_rows(table, "recording", path)
    if not listed_rows:
        raise InputError(f'{path}: there is no [[recording]]; add one with file = "..."')
    options = _options(table, head, path, notes, Answer(path, text))
    places = [f"{path}: [[recording]] {i + 1}" for i in range(len(listed_rows))]
    files = [_files(row, head.folder, where) for row, where in zip(listed_rows, places, strict=True)]
    parts = shares([max(map(count_rows, group)) for group in files])
    advance = _advance([file for group in files for file in group], progress)
    groups, names = [], list[str]()
    for row, own, share, where in zip(listed_rows, files, parts, places, strict=True):
        model, name = _model_and_name(row, head, own, where, notes)
        names.append(name)
        stated = head.control.interpolation_of(name)
        said = replace(options, hold=stated in (None, "hold"), shift=head.control.shift_of(name))
        if share is None:
            groups.append(_whole(own, model, name, said, advance))
        else:
            groups.append(_stretches(own, model, name, said, advance, share, notes))
    head.control.check_names(names, str(path))
    groups = _without_lagging_velocities(groups, notes)
    groups = with_bases(groups, notes)
    recordings = _split(groups, [row.get("split") for row in listed_rows], str(path), parts[0] is None)
    recordings = _with_interpolation(recordings, head.control, notes)
    return replace(
        head,
        recordings=tuple(recordings),
        notes=tuple(notes),
        sources=options.sources,
        factors=options.factors,
    )


def _options(table: Mapping[str, Any], head: Dataset, path: Path, notes: list[str], answer: Answer) -> LogOptions:
    """What the tables [columns], [units], [topics] and [model] say about logs."""

    def texts(key: str) -> Mapping[str, str]:
        found = table.get(key, {})
        if not isinstance(found, Mapping) or not all(isinstance(value, str) for value in found.values()):
            raise InputError(f'{path}: [{key}]: expected lines of "NAME" = "NAME", got {found!r}')
        return found

    units = {name: ColumnUnit.of(text) for name, text in texts("units").items()}
    for name, unit in units.items():
        if unit is None:
            raise InputError(
                f"{path}: [units] {name!r} = {table['units'][name]!r}: expected one of {', '.join(UNITS)}, perhaps "
                'with a number ("turn/4096", "0.48 Nm/A")'
            )
    check_keys(texts("topics"), tuple(TOPICS), f"{path}: [topics]", notes)
    unmeasured, names = toml_section(table, "model", path).get("unmeasured", []), part_names(head.model, "joint")
    if not isinstance(unmeasured, list) or not all(name in names for name in unmeasured):
        raise InputError(f"{path}: [model] unmeasured = {unmeasured!r}: expected a list of joints, of {listed(names)}")
    stated = {name: unit for name, unit in units.items() if unit}
    return LogOptions(texts("columns"), texts("topics"), unmeasured, stated, answer, forces=head.forces)


def _files(row: Mapping[str, Any], folder: Path, where: str) -> list[Path]:
    """The files of a row: one, or several that were written at the same time."""
    names = row["file"] if isinstance(row.get("file"), list) else [row.get("file")]
    if not 0 < len(names) <= 100:
        raise InputError(f"{where}: file lists {len(names)} names; expected 1 to 100")
    files = [file_inside({"file": name}, "file", folder, where) for name in names]
    for file in files:
        if not is_log(file) and not file.is_file():
            raise InputError(f"{where}: there is no file {file}")
    return files


def _model_and_name(
    row: Mapping[str, Any], head: Dataset, files: Sequence[Path], where: str, notes: list[str]
) -> tuple[mujoco.MjModel, str]:
    """The model of a row, with its overrides, and its name."""
    check_keys(row, ("file", "split", "model", "overrides", "name"), where, notes)
    model, overrides, name = head.model, row.get("overrides"), row.get("name", files[0].stem)
    if "model" in row:
        model, _ = load_model(file_inside(row, "model", head.folder, where), head.folder)
        if model_columns(model) != model_columns(head.model):
            raise InputError(f"{where}: model {row['model']!r} has other joints or actuators than the dataset's model")
        model = driven_by_forces(model) if head.forces else model
    if overrides:
        if not isinstance(overrides, Mapping) or not all(is_number(v) for v in overrides.values()):
            raise InputError(f'{where}: overrides: expected {{"body:arm/mass" = 0.5, ...}}, got {overrides!r}')
        model = copy.deepcopy(model)
        try:
            set_values(model, overrides)
        except InputError as error:
            raise InputError(f"{where}: overrides: {error}") from None
    if not isinstance(name, str) or not 0 < len(name) <= 200 or not name.isprintable():
        raise InputError(f"{where}: name = {name!r}: expected a text of one line, at most 200 characters")
    return model, name


def _whole(
    files: Sequence[Path], model: mujoco.MjModel, name: str, options: LogOptions, advance: Advance
) -> list[Recording]:
    """A recording, or its parts between holes."""
    notes: list[str] = []
    tables = read_log(files, model, options, notes, advance)
    found = make_recordings(tables, model, ", ".join(map(str, files)), name, options.hold, options.shift)
    return [replace(one, notes=(*notes, *one.notes)) for one in found]


def _stretches(
    files: Sequence[Path],
    model: mujoco.MjModel,
    name: str,
    options: LogOptions,
    advance: Advance,
    share: Share,
    notes: list[str],
) -> list[Recording]:
    """Stretches of a long recording."""
    found, file = list[Recording](), ", ".join(map(str, files))
    pieces, shift = read_stretches(files, share, model, notes, advance, options)
    for columns in pieces:
        start = float(columns["time"][0])
        where, own = f"{file} from {start:.6g} s on", f"{name} at {start:.6g} s"
        try:
            found += [replace(one, log=name) for one in make_recordings([columns], model, where, own, shift=shift)]
        except EmptyRecording as error:
            notes.append(f"left out: {error}")
    if not found:
        raise InputError(f"{file}: no stretch of it has {MIN_SAMPLES} rows in a row with all values")
    return found


def with_bases(groups: Sequence[Sequence[Recording]], notes: list[str]) -> list[list[Recording]]:
    """Groups of recordings with estimated states of a base without a measured pose, unless its IMU contradicts itself.

    Args:
      groups: recordings of one robot.
      notes: what was found is appended.

    Raises:
      InputError: the robot can touch nothing from which its motion could be estimated.
    """
    hidden = [one for group in groups for one in group if base_unmeasured(one)]
    if not hidden:
        return [list(group) for group in groups]
    from btr_mjx.gap.data.base.estimate import estimate_bases  # slow to load

    try:
        found = iter(estimate_bases(hidden, notes))
    except np.linalg.LinAlgError:  # the checks say what is wrong with the IMU
        return [list(group) for group in groups]
    return [[next(found) if base_unmeasured(one) else one for one in group] for group in groups]


def with_imu(recordings: Sequence[Recording], checkpoint: Callable[[], object] = lambda: None) -> list[Recording]:
    """Recordings whose base and an IMU on it were measured, with the states that agree with both and with the feet.

    Returned as they are: recordings without an IMU, those of a robot that touches nothing or whose IMU contradicts the
    pose, and those whose base was estimated when they were read.

    Args:
      recordings: of one robot.
      checkpoint: called often; it may raise to stop.
    """
    if not any(one.sensor for one in recordings):
        return list(recordings)
    from btr_mjx.gap.data.base.estimate import sharpened_bases  # slow to load

    return sharpened_bases(recordings, checkpoint)


def _without_lagging_velocities(groups: Sequence[Sequence[Recording]], notes: list[str]) -> list[list[Recording]]:
    """The recordings, with velocities estimated where the measured ones lag the positions."""
    model, lags, moves = groups[0][0].model, dict[int, float](), dict[int, np.ndarray]()
    every = [one for group in groups for one in group]
    # Displacements of a free or ball joint are in the directions of its velocities; those of a hinge are its angle.
    for i, r in enumerate(every):
        steps = difference(model, r.qpos[:-1], r.qpos[1:])
        moves[i] = np.concatenate([np.zeros((1, model.nv)), np.cumsum(steps, 0)])
    for dof in range(model.nv):
        tracks = [(r.time, moves[i][:, dof], r.qvel[:, dof]) for i, r in enumerate(every) if r.qvel_measured[dof]]
        if tracks and (lag := velocity_lag(tracks)):
            lags[dof] = lag
    if not lags:
        return [list(group) for group in groups]
    names = part_names(model, "joint")
    for word, own in (("lag", [v for v in lags if lags[v] > 0]), ("lead", [v for v in lags if lags[v] < 0])):
        if own:
            size = 1e3 * np.abs([lags[v] for v in own])
            apart = f" ({size.min():.3g} to {size.max():.3g} ms)" if len(own) > 1 else ""
            notes.append(
                f"velocities {word} the slope of the positions by {np.median(size):.3g} ms{apart}, as behind a filter: "
                f"they are left out ({', '.join(dict.fromkeys(names[model.dof_jntid[v]] for v in own))})"
            )
    dofs = list(lags)

    def mended(one: Recording) -> Recording:
        measured, qvel = one.qvel_measured.copy(), one.qvel.copy()
        measured[dofs], qvel[:, dofs] = False, estimate_velocity(one.model, one.time, one.qpos)[:, dofs]
        return replace(one, qvel=qvel, qvel_measured=measured)

    return [[mended(one) for one in group] for group in groups]


def _with_interpolation(recordings: Sequence[Recording], control: Control, notes: list[str]) -> list[Recording]:
    """Recordings with the interpolation that dataset.toml says, or else that which fits the commands of each."""
    out, said = list(recordings), dict[str, list[str]]()
    for log in dict.fromkeys(one.log for one in recordings):
        own = [i for i, one in enumerate(recordings) if one.log == log]
        interpolation = control.interpolation_of(log)
        if interpolation is None:
            interpolation, why = suitable_interpolation([recordings[i] for i in own])
            said.setdefault(why, []).append(log)
        for i in own:
            out[i] = replace(out[i], interpolation=interpolation)
    for why, logs in said.items():
        if why:
            notes.append(why if sum(map(len, said.values())) == len(logs) else f"{listed(logs)}: {why}")
    return out


def suitable_interpolation(recordings: Sequence[Recording]) -> tuple[Interpolation, str]:
    """The interpolation that fits the commands of a recording's parts, and why; "" where nothing speaks for another."""
    if any(one.held_commands for one in recordings):
        return "hold", 'commands come at a rate of their own: interpolation = "hold" was chosen'
    found = stairs([r.commands[1] for r in recordings])
    if found is None:
        return ("cubic" if bends([r.commands for r in recordings]) else "linear"), ""
    return "hold", (
        f"commands are stairs (they change every {found.every:.3g}th row, never in two rows that follow each other): "
        'interpolation = "hold" is used; put it into [control] to say so'
    )


def _advance(files: Sequence[Path], progress: ReadProgress | None) -> Advance:
    """Adds up the bytes that were read."""
    total, done = sum(file.stat().st_size for file in files if file.is_file()), 0

    def advance(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, total)

    advance(0)
    return advance


def _split(groups: Sequence[Sequence[Recording]], given: Sequence[Any], where: str, whole: bool) -> list[Recording]:
    """Recordings with their split, see `assign_splits`; that of a recording is that of its parts or stretches."""
    if len(groups) == 1 and given[0] is None and whole:
        return split_parts(groups[0], where)
    if len(groups) == 1 and given[0] is None:
        return assign_splits(groups[0], [None] * len(groups[0]), where)
    first = assign_splits([group[0] for group in groups], given, where)
    return [replace(one, split=side.split) for group, side in zip(groups, first, strict=True) for one in group]
