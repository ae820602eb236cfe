"""Measured data: a dataset is a folder with `dataset.toml`, the model that is believed, and recordings.

    [model]
    file = "robot.xml"                  # MJCF that is believed

    [[parameter]]                       # may be refitted before anything is called missing (any number, or none)
    name = "knee damping"
    path = "joint:knee/damping"         # see `model_paths`; a list of paths changes together
    bounds = [0.0, 2.0]                 # SI units, angles in rad
    relative = false                    # true: the value is a factor on every recording's own number

    [[recording]]
    file = "walk_1.csv"                 # .csv, .parquet or .npz, columns as in `columns`
    split = "fit"                       # or "test"; without any split the last third is held out
    model = "heavy.xml"                 # optional: a model of its own, of the same joints and actuators
    overrides = {"body:arm/mass" = 0.5} # optional: numbers that differ in this recording

    [control]
    interpolation = "linear"            # what the command does between samples: "hold", "linear" or "cubic"

    [tolerances]                        # optional: what calibration always leaves, 1 sigma, by effect
    viscous_damping = 0.1

    [noise]                             # optional: 1 sigma of the sensors; estimated from the data where not given
    qpos = 0.001                        # hinges [rad] and slides [m]
    qvel = 0.05                         # [rad/s], [m/s]
    position = 0.001                    # free joints [m]
    rotation = 0.002                    # free and ball joints [rad]
    velocity = 0.02                     # free joints [m/s]
    angular_velocity = 0.03             # free and ball joints [rad/s]
    "qpos/knee" = 0.002                 # one joint's own; also "qvel/knee", and any single column

Velocities that were not measured are estimated by local cubics, and the recording says so.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from btr_mjx.errors import InputError, one_line
from btr_mjx.gap.believed import Believed, read_believed
from btr_mjx.gap.columns import check_names, control_columns, read_columns, spread, state_columns
from btr_mjx.gap.model_paths import set_values
from btr_mjx.gap.noise import Noise, estimate_noise, read_noise
from btr_mjx.gap.samples import check_time, estimate_velocity, normalise, sound_rows
from btr_mjx.gap.toml_tables import check_keys, file_name, is_number, read_toml, toml_rows, toml_section

FILE_NAME = "dataset.toml"
TABLES = ("model", "parameter", "recording", "control", "tolerances", "noise")
"""Tables of dataset.toml."""
MIN_SAMPLES = 20
"""A recording shorter than this holds no window."""

Split = Literal["fit", "test"]
Interpolation = Literal["hold", "linear", "cubic"]


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording.

    Attributes:
      name: file name without suffix.
      time: (K,) [s], increasing.
      ctrl: (K, nu) commands.
      qpos: (K, nq), qvel: (K, nv) measured states in MuJoCo's conventions.
      qvel_measured: (nv,) bool; False where the velocity was estimated from positions.
      split: "fit" or "test" (held out).
      model: the believed model of this recording, with its overrides.
      force: (K,) measured actuator forces by actuator.
      sensor: (K,) other measurements by name.
      notes: what the loader had to do, for preflight.
    """

    name: str
    time: np.ndarray
    ctrl: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    qvel_measured: np.ndarray
    split: Split
    model: mujoco.MjModel
    force: Mapping[str, np.ndarray] = field(default_factory=dict)
    sensor: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def part(self, rows: slice, split: Split, name: str) -> "Recording":
        """A stretch of the recording under another name."""
        return replace(
            self,
            name=name,
            split=split,
            **{key: getattr(self, key)[rows] for key in ("time", "ctrl", "qpos", "qvel")},
            force={key: value[rows] for key, value in self.force.items()},
            sensor={key: value[rows] for key, value in self.sensor.items()},
        )


@dataclass(frozen=True, eq=False)
class Dataset:
    """Recordings of one robot and the model that is believed of it.

    Attributes:
      folder: where it came from.
      model: the believed model.
      model_file: its MJCF file.
      spec_xml: its MJCF text.
      parameters: what may be refitted.
      recordings: all of them, in the order of the file.
      interpolation: what the command does between samples.
      tolerances: 1 sigma of what calibration always leaves, by effect.
      noise: as given; None where it has to be estimated.
      notes: what the loader found odd, for preflight.
    """

    folder: Path
    model: mujoco.MjModel
    model_file: Path
    spec_xml: str
    parameters: tuple[Believed, ...]
    recordings: tuple[Recording, ...]
    interpolation: Interpolation = "linear"
    tolerances: Mapping[str, float] = field(default_factory=dict)
    noise: Noise | None = None
    notes: tuple[str, ...] = ()

    @property
    def fit(self) -> tuple[Recording, ...]:
        """Recordings to fit."""
        return tuple(r for r in self.recordings if r.split == "fit")

    @property
    def test(self) -> tuple[Recording, ...]:
        """Recordings held out."""
        return tuple(r for r in self.recordings if r.split == "test")


def load(folder: str | Path) -> Dataset:
    """Read a dataset.

    Args:
      folder: the folder, or its dataset.toml.

    Raises:
      InputError: anything wrong with it, in one line: the value, its place, the remedy.
      DamagedFile: a file that does not parse.
      OSError: a file that cannot be read.
    """
    head, table = read_head(folder)
    path, notes = head.folder / FILE_NAME, list(head.notes)
    listed = toml_rows(table, "recording", path)
    if not listed:
        raise InputError(f'{path}: there is no [[recording]]; add one with file = "..."')
    recordings = [
        read_recording(head.folder, row, head.model, f"{path}: [[recording]] {i + 1}", notes)
        for i, row in enumerate(listed)
    ]
    parts = split(recordings, [row.get("split") for row in listed], str(path))
    return replace(head, recordings=tuple(parts), notes=tuple(notes))


def read_head(folder: str | Path, more: Sequence[str] = ()) -> tuple[Dataset, dict[str, Any]]:
    """Read what dataset.toml says beside its recordings.

    Args:
      folder: the folder, or its dataset.toml.
      more: further tables that it may hold.

    Returns:
      A dataset without recordings, and the file's tables.

    Raises:
      InputError, DamagedFile, OSError: see `load`.
    """
    folder = Path(folder)
    folder = folder.parent if folder.name == FILE_NAME and folder.is_file() else folder
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give a folder that holds {FILE_NAME}")
    path = folder / FILE_NAME
    if not path.is_file():
        raise InputError(f"{folder}: it holds no {FILE_NAME}; see btr_mjx/gap/recordings.py for its form")
    table = read_toml(path)
    notes: list[str] = []
    check_keys(table, (*TABLES, *more), f"{path}", notes)
    about = toml_section(table, "model", path)
    check_keys(about, ("file",), f"{path}: [model]", notes)
    model_file = folder / file_name(about, "file", f"{path}: [model]")
    model, spec_xml = load_model(model_file)
    control = table.get("control", {})
    check_keys(control, ("interpolation",), f"{path}: [control]", notes)
    interpolation = control.get("interpolation", "linear")
    if interpolation not in ("hold", "linear", "cubic"):
        raise InputError(f"{path}: interpolation {interpolation!r}: expected 'hold', 'linear' or 'cubic'")
    head = Dataset(
        folder=folder,
        model=model,
        model_file=model_file,
        spec_xml=spec_xml,
        parameters=tuple(
            read_believed(row, model, f"{path}: [[parameter]] {i + 1}", notes)
            for i, row in enumerate(toml_rows(table, "parameter", path))
        ),
        recordings=(),
        interpolation=interpolation,
        tolerances=_tolerances(table.get("tolerances", {}), path),
        noise=read_noise(table.get("noise", {}), model, f"{path}: [noise]", notes),
        notes=tuple(notes),
    )
    return head, table


def noise_of(dataset: Dataset) -> Noise:
    """The sensors' noise: as given, else estimated from all recordings."""
    if dataset.noise is not None:
        return dataset.noise
    return estimate_noise(dataset.model, [(r.time, r.qpos, r.qvel, r.qvel_measured) for r in dataset.recordings])


def load_model(path: Path) -> tuple[mujoco.MjModel, str]:
    """Compile an MJCF file.

    Returns:
      The model, and the file's text.

    Raises:
      InputError: the file is absent or MuJoCo does not accept it.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such model file")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo does not load this model: {one_line(error)}") from None
    if model.nu == 0 or model.njnt == 0:
        raise InputError(f"{path}: the model has {model.njnt} joints and {model.nu} actuators; expected some of both")
    return model, path.read_text(encoding="utf-8")


def read_recording(
    folder: Path, row: Mapping[str, Any], base: mujoco.MjModel, where: str, notes: list[str]
) -> Recording:
    """Read one [[recording]] row of a dataset in `folder`.

    Args:
      folder: the dataset's.
      row: the row.
      base: the dataset's model.
      where: the row's place, for messages.
      notes: oddities are added here.

    Raises:
      InputError: see `load`.
    """
    check_keys(row, ("file", "split", "model", "overrides", "name"), where, notes)
    file = folder / file_name(row, "file", where)
    if not file.is_file():
        raise InputError(f"{where}: there is no file {file}")
    model = base
    if "model" in row:
        model, _ = load_model(folder / file_name(row, "model", where))
        if state_columns(model) != state_columns(base) or control_columns(model) != control_columns(base):
            raise InputError(f"{where}: model {row['model']!r} has other joints or actuators than the dataset's model")
    if row.get("overrides"):
        overrides = row["overrides"]
        if not isinstance(overrides, Mapping) or not all(is_number(v) for v in overrides.values()):
            raise InputError(f'{where}: overrides: expected {{"body:arm/mass" = 0.5, ...}}, got {overrides!r}')
        model = mujoco.MjModel.from_xml_path(str(folder / row["model"])) if "model" in row else copy.deepcopy(base)
        try:
            set_values(model, overrides)
        except InputError as error:
            raise InputError(f"{where}: overrides: {error}") from None
    return assemble(read_columns(file), model, str(file), str(row.get("name", file.stem)))


def assemble(columns: Mapping[str, np.ndarray], model: mujoco.MjModel, where: str, name: str) -> Recording:
    """Make a recording of a table's columns.

    Args:
      columns: as of `columns.read_columns`.
      model: the recording's model.
      where: file, for messages.
      name: the recording's name.

    Raises:
      InputError: columns that are missing or name nothing, time that does not increase, runs of missing values,
        quaternions that are none, too few samples.
    """
    flat = spread(columns, model, where)
    ignored = check_names(flat, model, where)
    notes = [f"columns without a use: {', '.join(ignored[:8])}{', ...' if len(ignored) > 8 else ''}"] if ignored else []
    positions, velocities = state_columns(model)
    measured = np.array([c in flat for c in velocities])
    needed = ["time", *positions, *control_columns(model), *(c for c in velocities if c in flat)]
    sound = sound_rows(flat, needed, where, notes)
    flat = {key: value[sound] for key, value in flat.items()}
    time = flat["time"]
    check_time(time, where)
    if len(time) < MIN_SAMPLES:
        raise InputError(f"{where}: {len(time)} samples are too short for a window; expected at least {MIN_SAMPLES}")
    qpos = np.stack([flat[c] for c in positions], axis=1)
    normalise(qpos, model, where)
    qvel = np.empty((len(time), model.nv))
    if not measured.all():
        qvel = estimate_velocity(model, time, qpos)
        names = sorted({c.split("/")[1] for c, m in zip(velocities, measured, strict=True) if not m})
        notes.append(f"velocity estimated from positions: {', '.join(names[:8])}{', ...' if len(names) > 8 else ''}")
    for i in np.flatnonzero(measured):
        qvel[:, i] = flat[velocities[i]]
    return Recording(
        name=name,
        time=time,
        ctrl=np.stack([flat[c] for c in control_columns(model)], axis=1),
        qpos=qpos,
        qvel=qvel,
        qvel_measured=measured,
        split="fit",
        model=model,
        force={c.partition("/")[2]: v for c, v in flat.items() if c.startswith("force/")},
        sensor={c.partition("/")[2]: v for c, v in flat.items() if c.startswith("sensor/")},
        notes=tuple(notes),
    )


def split(recordings: Sequence[Recording], given: Sequence[Any], where: str) -> list[Recording]:
    """Decide which recordings are held out.

    Args:
      recordings: all of them.
      given: what the dataset says of each: "fit", "test" or None.
      where: file, for messages.

    Returns:
      The recordings with their split. Where nothing is said, the last third is held out; a single recording is cut
      at two thirds of its time. Where only some have a split, the others are fitted.

    Raises:
      InputError: another word, or all in one split.
    """
    for i, word in enumerate(given):
        if word not in (None, "fit", "test"):
            raise InputError(f"{where}: [[recording]] {i + 1}: split {word!r}: expected 'fit' or 'test'")
    if any(given):
        words: list[Split] = ["test" if word == "test" else "fit" for word in given]
        if len(set(words)) == 1:
            other = "test" if words[0] == "fit" else "fit"
            raise InputError(
                f"{where}: all {len(words)} recordings are in split {words[0]!r}; mark some of them split = {other!r}, "
                "or leave split out everywhere"
            )
        return [replace(r, split=word) for r, word in zip(recordings, words, strict=True)]
    if len(recordings) > 1:
        held_out = max(1, len(recordings) // 3)
        return [
            replace(r, split="test" if i >= len(recordings) - held_out else "fit") for i, r in enumerate(recordings)
        ]
    only = recordings[0]
    cut = int(np.searchsorted(only.time, only.time[0] + 2 / 3 * (only.time[-1] - only.time[0])))
    if min(cut, len(only.time) - cut) < MIN_SAMPLES:
        raise InputError(f"{where}: the only recording is too short to hold out a third of it; add another one")
    return [
        only.part(slice(None, cut), "fit", f"{only.name} (first part)"),
        only.part(slice(cut, None), "test", f"{only.name} (last third)"),
    ]


def _tolerances(table: Any, path: Path) -> dict[str, float]:
    if not isinstance(table, Mapping):
        raise InputError(f"{path}: [tolerances]: expected a table, got {table!r}")
    for key, value in table.items():
        if not is_number(value) or value < 0:
            raise InputError(f"{path}: [tolerances] {key} = {value!r}: expected a standard deviation of 0 or more")
    return {key: float(value) for key, value in table.items()}
