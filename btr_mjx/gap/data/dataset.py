"""Datasets: a folder with `dataset.toml`, the MJCF of the believed model, and recordings.

    [model]
    file = "robot.xml"                  # MJCF of the believed model
    unmeasured = ["passive_knee"]       # optional: joints without an encoder

    [[parameter]]                       # parameters that may be refitted (any number, or none)
    name = "knee damping"
    path = "joint:knee/damping"         # see `btr_mjx.models.parse_path`; a list of paths is set together
    bounds = [0.0, 2.0]                 # SI units, angles in rad
    relative = false                    # true: the value is a factor on the number in each recording's model

    [[recording]]
    file = "walk_1.csv"                 # any of `logs.LOG_SUFFIXES`; a list of files that were written together
    split = "fit"                       # or "test" (held out); default: the last third is held out
    model = "heavy.xml"                 # optional: its own model, with the same joints and actuators
    overrides = {"body:arm/mass" = 0.5} # optional: numbers that differ in this recording

    [control]
    interpolation = "linear"            # of the command between samples: "hold", "linear" or "cubic"; by default
                                        # "hold" for stairs, "cubic" for smooth commands, else "linear"

    [tolerances]                        # optional: 1 sigma of residual calibration errors, by effect
    viscous_damping = 0.1

    [columns]                           # optional: names of the log = names of the model, see `names`
    "Hip angle" = "qpos/hip"

    [units]                             # optional: units of columns whose names state none
    "Hip angle" = "deg"

    [topics]                            # optional: of ROS recordings, see `formats.ros_bag`
    joint_states = "/joint_states"

    [noise]                             # optional: 1 sigma of the sensors; default: estimated
    qpos = 0.001                        # hinges [rad] and slides [m]
    qvel = 0.05                         # [rad/s], [m/s]
    position = 0.001                    # free joints [m]
    rotation = 0.002                    # free and ball joints [rad]
    velocity = 0.02                     # free joints [m/s]
    angular_velocity = 0.03             # free and ball joints [rad/s]
    "qpos/knee" = 0.002                 # of one joint; also "qvel/knee", and any single column

Velocities that were not measured are estimated by local cubic fits and marked in `Recording.qvel_measured`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.formats.lerobot_scales import JointScale
from btr_mjx.gap.data.formats.ros_bag import TOPICS
from btr_mjx.gap.data.held import bends, stairs
from btr_mjx.gap.data.logs import LogOptions
from btr_mjx.gap.data.long_files import Advance, count_rows, shares
from btr_mjx.gap.data.model_file import load_model
from btr_mjx.gap.data.names.remedy import Answer
from btr_mjx.gap.data.names.units import UNITS, known_unit
from btr_mjx.gap.data.noise import Noise, estimate_noise, read_noise, without_sensor
from btr_mjx.gap.data.reading import Reading, read_recording, recording_files
from btr_mjx.gap.data.recording import Recording
from btr_mjx.gap.data.samples import estimate_velocity, velocity_lag
from btr_mjx.gap.data.splits import assign_splits, split_parts
from btr_mjx.models import PathParameter, difference, part_names, read_path_parameter
from btr_mjx.runs import check_keys, file_inside, is_number, read_toml, toml_rows, toml_section

DATASET_FILE = "dataset.toml"
"""Name of the file that describes a dataset folder."""
TABLES = ("model", "parameter", "recording", "control", "tolerances", "noise", "columns", "units", "topics")
"""Tables that dataset.toml may hold."""

Interpolation = Literal["hold", "linear", "cubic"]
"""The command between two samples: that of the earlier one, a straight line, a cubic spline."""
ReadProgress = Callable[[int, int], None]
"""Called with the bytes that were read so far, and those of all files."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Recordings of one robot and its believed model.

    Attributes:
      folder: its folder.
      model: the believed model.
      model_file: MJCF file of the model.
      spec_xml: MJCF text of the model.
      parameters: parameters that may be refitted.
      recordings: all recordings, in the order of the file.
      interpolation: of the command between samples.
      tolerances: 1 sigma of residual calibration errors, by effect name.
      noise: sensor noise as given; None if it must be estimated.
      notes: warnings of the loader, reported by preflight.
      inferred: text of the dataset.toml that was inferred from the logs; "" where there is one.
      sources: names of columns in the logs, by name of the model; empty where they have the model's names.
      scales: how numbers of a LeRobot dataset became positions, by joint; empty for other formats.
    """

    folder: Path
    model: mujoco.MjModel
    model_file: Path
    spec_xml: str
    parameters: tuple[PathParameter, ...]
    recordings: tuple[Recording, ...]
    interpolation: Interpolation = "linear"
    tolerances: Mapping[str, float] = field(default_factory=dict)
    noise: Noise | None = None
    notes: tuple[str, ...] = ()
    inferred: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    scales: Mapping[str, JointScale] = field(default_factory=dict)

    @property
    def fit(self) -> tuple[Recording, ...]:
        """Recordings with split "fit"."""
        return tuple(r for r in self.recordings if r.split == "fit")

    @property
    def test(self) -> tuple[Recording, ...]:
        """Recordings with split "test" (held out)."""
        return tuple(r for r in self.recordings if r.split == "test")


def load(folder: str | Path, progress: ReadProgress | None = None) -> Dataset:
    """Read a dataset.

    Args:
      folder: the folder, or its dataset.toml.
      progress: called while recordings are read.

    Returns:
      The dataset, with all recordings loaded, or stretches of them where they have more than
      `long_files.MAX_SAMPLES` samples together; a note says which share is used.

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
    """Read the recordings of a dataset whose header was read.

    Args:
      head: the dataset without recordings.
      table: content of dataset.toml.
      path: of dataset.toml, for messages.
      progress: called while recordings are read.
      text: of dataset.toml, where there is no such file yet.

    Raises:
      InputError, DamagedFile, OSError: see `load`.
    """
    notes = list(head.notes)
    listed = toml_rows(table, "recording", path)
    if not listed:
        raise InputError(f'{path}: there is no [[recording]]; add one with file = "..."')
    stated = table.get("control", {}).get("interpolation")
    options = LogOptions(
        _texts(table, "columns", path),
        _topics(table, path, notes),
        _unmeasured(table, head.model, path),
        _units(table, path),
        Answer(path, text),
    )
    reading = Reading(options, hold=stated in (None, "hold"))
    places = [f"{path}: [[recording]] {i + 1}" for i in range(len(listed))]
    files = [recording_files(row, head.folder, where) for row, where in zip(listed, places, strict=True)]
    advance = _advance([file for group in files for file in group], progress)
    rows = [max(count_rows(file) for file in group) for group in files]
    groups = [
        read_recording(head.folder, row, head.model, where, notes, share, advance, reading)
        for row, where, share in zip(listed, places, shares(rows), strict=True)
    ]
    whole = sum(rows) == 0 or all(share is None for share in shares(rows))
    groups = _without_lagging_velocities(groups, notes)
    parts = _split(groups, [row.get("split") for row in listed], str(path), whole)
    interpolation = head.interpolation if stated else _suitable_interpolation(parts, notes)
    mended = replace(head, recordings=tuple(parts), notes=tuple(notes), interpolation=interpolation)
    return replace(mended, sources=options.sources)


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


def _suitable_interpolation(recordings: Sequence[Recording], notes: list[str]) -> Interpolation:
    """The interpolation of commands for which dataset.toml names none."""
    if any(one.held_commands for one in recordings):
        notes.append('commands come at a rate of their own: interpolation = "hold" was chosen')
        return "hold"
    found = stairs([r.commands[1] for r in recordings])
    if found is None:
        return "cubic" if bends([r.commands for r in recordings]) else "linear"
    notes.append(
        f"commands are stairs (they change every {found.every:.3g}th row, never in two rows that follow each other): "
        'interpolation = "hold" is used; put it into [control] to say so'
    )
    return "hold"


def _texts(table: Mapping[str, Any], key: str, path: Path) -> Mapping[str, str]:
    found = table.get(key, {})
    if not isinstance(found, Mapping) or not all(isinstance(value, str) for value in found.values()):
        raise InputError(f'{path}: [{key}]: expected lines of "NAME" = "NAME", got {found!r}')
    return found


def _units(table: Mapping[str, Any], path: Path) -> Mapping[str, str]:
    """Units by name in the log, as `UNITS` names them."""
    found = {name: known_unit(text) for name, text in _texts(table, "units", path).items()}
    for name, unit in found.items():
        if unit is None:
            raise InputError(f"{path}: [units] {name!r} = {table['units'][name]!r}: expected one of {', '.join(UNITS)}")
    return {name: unit for name, unit in found.items() if unit}


def _unmeasured(table: Mapping[str, Any], model: mujoco.MjModel, path: Path) -> Sequence[str]:
    """Names of the joints that are said to have no encoder."""
    found, names = toml_section(table, "model", path).get("unmeasured", []), part_names(model, "joint")
    if not isinstance(found, list) or not all(name in names for name in found):
        raise InputError(f"{path}: [model] unmeasured = {found!r}: expected a list of joints, of {', '.join(names)}")
    return found


def _topics(table: Mapping[str, Any], path: Path, notes: list[str]) -> Mapping[str, str]:
    found = _texts(table, "topics", path)
    check_keys(found, tuple(TOPICS), f"{path}: [topics]", notes)
    return found


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


def read_header(folder: str | Path, more: Sequence[str] = ()) -> tuple[Dataset, dict[str, Any]]:
    """Read everything in dataset.toml except the recordings.

    Args:
      folder: the folder, or its dataset.toml.
      more: names of further tables that it may hold.

    Returns:
      A dataset without recordings, and the file's tables.

    Raises:
      InputError, DamagedFile, OSError: see `load`.
    """
    folder = Path(folder)
    folder = folder.parent if folder.name == DATASET_FILE and folder.is_file() else folder
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give a folder that holds {DATASET_FILE}")
    path = folder / DATASET_FILE
    if not path.is_file():
        raise InputError(f"{folder}: it holds no {DATASET_FILE}; see btr_mjx/gap/data/dataset.py for its form")
    table = read_toml(path)
    return header_of(table, folder, path, more), table


def header_of(table: Mapping[str, Any], folder: Path, path: Path, more: Sequence[str] = ()) -> Dataset:
    """The dataset without recordings that the tables of a dataset.toml describe.

    Args:
      table: content of the file.
      folder: of the files that it names.
      path: of the file, for messages.
      more: names of further tables that it may hold.

    Raises:
      InputError, DamagedFile, OSError: see `load`.
    """
    notes: list[str] = []
    check_keys(table, (*TABLES, *more), f"{path}", notes)
    about = toml_section(table, "model", path)
    check_keys(about, ("file", "unmeasured"), f"{path}: [model]", notes)
    model_file = file_inside(about, "file", folder, f"{path}: [model]")
    model, spec_xml = load_model(model_file, folder)
    control = table.get("control", {})
    check_keys(control, ("interpolation",), f"{path}: [control]", notes)
    interpolation = control.get("interpolation", "linear")
    if interpolation not in ("hold", "linear", "cubic"):
        raise InputError(f"{path}: interpolation {interpolation!r}: expected 'hold', 'linear' or 'cubic'")
    return Dataset(
        folder=folder,
        model=model,
        model_file=model_file,
        spec_xml=spec_xml,
        parameters=tuple(
            read_path_parameter(row, model, f"{path}: [[parameter]] {i + 1}", notes)
            for i, row in enumerate(toml_rows(table, "parameter", path))
        ),
        recordings=(),
        interpolation=interpolation,
        tolerances=_tolerances(table.get("tolerances", {}), path),
        noise=read_noise(table.get("noise", {}), model, f"{path}: [noise]", notes),
        notes=tuple(notes),
    )


def noise_of(dataset: Dataset) -> Noise:
    """The sensor noise: as given in the dataset, else estimated from all recordings."""
    seen = np.all([r.seen for r in dataset.recordings], axis=0)
    if dataset.noise is not None:
        return without_sensor(dataset.noise, seen)
    tracks = [(r.time, r.qpos, r.qvel, r.qvel_measured) for r in dataset.recordings]
    return without_sensor(estimate_noise(dataset.model, tracks), seen)


def _tolerances(table: Any, path: Path) -> dict[str, float]:
    if not isinstance(table, Mapping):
        raise InputError(f"{path}: [tolerances]: expected a table, got {table!r}")
    for key, value in table.items():
        if not is_number(value) or value < 0:
            raise InputError(f"{path}: [tolerances] {key} = {value!r}: expected a standard deviation of 0 or more")
    return {key: float(value) for key, value in table.items()}
