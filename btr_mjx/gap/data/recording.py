"""Recordings: measurement tables read with the believed model, and the split into fit and test.

`columns` defines the columns of a file; `dataset` reads the dataset that holds the recordings.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from btr_mjx.errors import InputError, one_line
from btr_mjx.gap.data.clocks import on_one_clock
from btr_mjx.gap.data.columns import check_names, control_columns, state_columns, ungroup_columns
from btr_mjx.gap.data.held import fresh_rows
from btr_mjx.gap.data.logs import LogOptions, is_log, read_log
from btr_mjx.gap.data.long_files import Advance, Share, read_stretches
from btr_mjx.gap.data.plausible import check_sizes, check_span
from btr_mjx.gap.data.samples import check_time, complete_rows, estimate_velocity, normalise_quaternions, whole_parts
from btr_mjx.gap.data.unmeasured import estimate_motion, unmeasured_joints
from btr_mjx.gap.data.wraps import unwrap_hinges
from btr_mjx.models import COMPILE_ERRORS, check_mjcf, check_model, part_names, set_values
from btr_mjx.runs import check_keys, file_inside, is_number, read_text

MIN_SAMPLES = 20
"""Smallest number of samples of a recording."""

Split = Literal["fit", "test"]


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording.

    Attributes:
      name: by default the file name without suffix.
      time: (K,) [s], increasing.
      ctrl: (K, nu) commands.
      qpos: (K, nq), qvel: (K, nv) measured states in MuJoCo's conventions.
      qvel_measured: (nv,) bool; False where the velocity was estimated from positions.
      qpos_measured: (nv,) bool; False at joints without an encoder, whose states are estimated; None for all measured.
      split: "fit" or "test" (held out).
      model: the believed model of this recording, with its overrides.
      force: (K,) measured actuator forces by actuator.
      sensor: (K,) other measurements by name.
      notes: corrections made by the loader, reported by preflight.
      sent: times (N,) [s] and commands (N, nu), where commands were logged at more times than states.
      held_commands: whether commands of a slower clock were held between their samples.
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
    sent: tuple[np.ndarray, np.ndarray] | None = None
    held_commands: bool = False
    qpos_measured: np.ndarray | None = None

    @property
    def commands(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (N,) [s] and commands (N, nu): all that are known."""
        return (self.time, self.ctrl) if self.sent is None else self.sent

    @property
    def seen(self) -> np.ndarray:
        """(nv,) bool: which positions were measured."""
        return np.ones(self.model.nv, bool) if self.qpos_measured is None else self.qpos_measured

    def part(self, rows: slice, split: Split, name: str) -> "Recording":
        """A part of the recording, as a recording with another name and split."""
        return replace(
            self,
            name=name,
            split=split,
            **{key: getattr(self, key)[rows] for key in ("time", "ctrl", "qpos", "qvel")},
            force={key: value[rows] for key, value in self.force.items()},
            sensor={key: value[rows] for key, value in self.sensor.items()},
        )


def load_model(path: Path, inside: Path) -> tuple[mujoco.MjModel, str]:
    """Compile an MJCF file.

    Args:
      path: the file.
      inside: folder of the dataset; the model may not name files outside of it.

    Returns:
      The model, and the file's text.

    Raises:
      InputError: the file is absent, MuJoCo rejects it, its numbers cannot be simulated, or the model has no joint.
      DamagedFile: it is not UTF-8.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such model file")
    text = read_text(path)
    check_mjcf(text, str(path), path.parent, inside)
    try:
        model = _compiled(path)
        mujoco.MjData(model)  # its memory can be taken
    except COMPILE_ERRORS as error:
        raise InputError(f"{path}: MuJoCo does not load this model: {one_line(error)}") from None
    if model.njnt == 0:
        raise InputError(f"{path}: the model has no joints, so that nothing can move; expected at least one")
    check_model(model, str(path))
    return model, text


def _compiled(path: Path) -> mujoco.MjModel:
    """Compile with body_simple = 0: effects edit inertia, which MuJoCo's simple bodies do not allow."""
    model = mujoco.MjModel.from_xml_path(str(path))
    if not model.body_simple[1:].any():
        return model
    spec = mujoco.MjSpec.from_file(str(path))
    for body in spec.bodies:
        body.simple = 0
    return spec.compile()


@dataclass(frozen=True)
class Reading:
    """How the recordings of a dataset are read.

    Attributes:
      options: what the dataset says about columns and topics.
      hold: hold commands of a slower clock between their samples, instead of interpolating them.
    """

    options: LogOptions = field(default_factory=LogOptions)
    hold: bool = True


def recording_files(row: Mapping[str, Any], folder: Path, where: str) -> list[Path]:
    """The files of a [[recording]] row: one, or several that were written at the same time.

    Raises:
      InputError: no name or list of names, a name that leads out of the folder, or no such file.
    """
    listed = row["file"] if isinstance(row.get("file"), list) else [row.get("file")]
    if not 0 < len(listed) <= 100:
        raise InputError(f"{where}: file lists {len(listed)} names; expected 1 to 100")
    files = [file_inside({"file": name}, "file", folder, where) for name in listed]
    for file in files:
        if not is_log(file) and not file.is_file():
            raise InputError(f"{where}: there is no file {file}")
    return files


def read_recording(
    folder: Path,
    row: Mapping[str, Any],
    base: mujoco.MjModel,
    where: str,
    notes: list[str],
    share: Share | None = None,
    advance: Advance = lambda count: None,
    reading: Reading = Reading(),
) -> list[Recording]:
    """Read one [[recording]] row of a dataset in `folder`.

    Args:
      folder: of the dataset.
      row: the row.
      base: the dataset's model.
      where: the row's place, for messages.
      notes: warnings are appended here.
      share: part of the recording that is used; None for all.
      advance: called with numbers of bytes that were read.
      reading: how columns are matched and commands brought to the clock of the states.

    Returns:
      The recording, or parts of it between holes, or stretches of it, with split "fit".

    Raises:
      InputError: see `dataset.load`.
    """
    check_keys(row, ("file", "split", "model", "overrides", "name"), where, notes)
    files = recording_files(row, folder, where)
    model = base
    if "model" in row:
        model, _ = load_model(file_inside(row, "model", folder, where), folder)
        if state_columns(model) != state_columns(base) or control_columns(model) != control_columns(base):
            raise InputError(f"{where}: model {row['model']!r} has other joints or actuators than the dataset's model")
    if row.get("overrides"):
        overrides = row["overrides"]
        if not isinstance(overrides, Mapping) or not all(is_number(v) for v in overrides.values()):
            raise InputError(f'{where}: overrides: expected {{"body:arm/mass" = 0.5, ...}}, got {overrides!r}')
        model = copy.deepcopy(model)
        try:
            set_values(model, overrides)
        except InputError as error:
            raise InputError(f"{where}: overrides: {error}") from None
    name, file = _name(row, files[0].stem, where), ", ".join(map(str, files))
    if share is None:
        said: list[str] = []
        tables = read_log(files, model, reading.options, said, advance)
        found = make_recordings(tables, model, file, name, reading.hold)
        return [replace(one, notes=(*said, *one.notes)) for one in found]
    found = []
    for columns in read_stretches(files, share, model, notes, advance, reading.options, reading.hold):
        start = float(columns["time"][0])
        try:
            found += make_recordings([columns], model, f"{file} from {start:.6g} s on", f"{name} at {start:.6g} s")
        except EmptyRecording as error:
            notes.append(f"left out: {error}")
    if not found:
        raise InputError(f"{file}: no stretch of it has {MIN_SAMPLES} rows in a row with all values")
    return found


def _name(row: Mapping[str, Any], default: str, where: str) -> str:
    name = row.get("name", default)
    if not isinstance(name, str) or not 0 < len(name) <= 200 or not name.isprintable():
        raise InputError(f"{where}: name = {name!r}: expected a text of one line, at most 200 characters")
    return name


class EmptyRecording(InputError):
    """A recording, or a stretch of one, in which too few rows have all values."""


def make_recording(columns: Mapping[str, np.ndarray], model: mujoco.MjModel, where: str, name: str) -> Recording:
    """Build a recording without holes from the columns of a table; see `make_recordings`.

    Raises:
      InputError: see `make_recordings`; also holes.
    """
    found = make_recordings([columns], model, where, name)
    if len(found) > 1:
        raise InputError(f"{where}: {found[0].notes[-1]}; expected a recording without holes")
    return found[0]


def make_recordings(
    tables: Sequence[Mapping[str, np.ndarray]], model: mujoco.MjModel, where: str, name: str, hold: bool = True
) -> list[Recording]:
    """Build the recordings of one log: one, or one for each part between holes.

    Args:
      tables: arrays by name, as `columns.read_columns` returns them, for each table with a clock of its own.
      model: the recording's model.
      where: file, for messages.
      name: the recording's name.
      hold: hold commands of a slower clock between their samples, instead of interpolating them.

    Raises:
      InputError: missing or unknown columns, time that does not increase, quaternions that are not of unit length.
      EmptyRecording: no part has `MIN_SAMPLES` samples.
    """
    notes: list[str] = []
    merged, held = on_one_clock([ungroup_columns(table, model, where) for table in tables], model, hold, where, notes)
    ignored = check_names(merged, model, where)
    unmeasured = unmeasured_joints(merged, model, where)
    notes += (
        [f"columns without a use: {', '.join(ignored[:8])}{', ...' if len(ignored) > 8 else ''}"] if ignored else []
    )
    positions, velocities = state_columns(model)
    positions = [c for c in positions if c in merged]
    needed = ["time", *positions, *control_columns(model), *(c for c in velocities if c in merged)]
    sound = complete_rows(merged, needed, where, notes)
    flat = {key: value[sound] for key, value in merged.items()}
    check_time(flat["time"], where)
    check_sizes(flat, needed, where)
    if len(sound) < MIN_SAMPLES:
        raise EmptyRecording(
            f"{where}: {len(sound)} samples are too short for a window; expected at least {MIN_SAMPLES}"
        )
    qpos = np.tile(model.qpos0, (len(sound), 1))
    seen = np.delete(np.arange(model.nq), model.jnt_qposadr[unmeasured])
    qpos[:, seen] = np.stack([flat[c] for c in positions], axis=1)
    normalise_quaternions(qpos, model, where)
    controls = control_columns(model)
    ctrl = np.stack([flat[c] for c in controls], axis=1) if controls else np.empty((len(sound), 0))
    unwrap_hinges(model, qpos, ctrl, notes)
    parts = whole_parts(sound, flat["time"], MIN_SAMPLES, notes)
    if not parts:
        raise EmptyRecording(f"{where}: {notes[-1]}; expected at least {MIN_SAMPLES} samples in a row with all values")
    return [
        _recording(
            {key: value[part] for key, value in flat.items()},
            qpos[part],
            ctrl[part],
            model,
            where,
            name if len(parts) == 1 else f"{name} (part {i + 1})",
            notes,
            held,
            unmeasured,
        )
        for i, part in enumerate(parts)
    ]


def _recording(
    flat: Mapping[str, np.ndarray],
    qpos: np.ndarray,
    ctrl: np.ndarray,
    model: mujoco.MjModel,
    where: str,
    name: str,
    notes: Sequence[str],
    held: bool,
    unmeasured: list[int],
) -> Recording:
    """The recording of rows without a hole."""
    time, notes = flat["time"], list(notes)
    check_span(time, where)
    sent = None
    fresh = fresh_rows(qpos)
    if fresh is not None and len(fresh.rows) >= MIN_SAMPLES:
        rate = (len(fresh.rows) - 1) / (time[fresh.rows[-1]] - time[0])
        notes.append(
            f"positions change every {fresh.every:.3g}th row only ({rate:.4g} Hz) and repeat in between: the fresh "
            "rows are used, commands in all rows"
        )
        sent = time, ctrl
        time, qpos, ctrl = time[fresh.rows], qpos[fresh.rows], ctrl[fresh.rows]
        flat = {key: value[fresh.rows] for key, value in flat.items()}
    _, velocities = state_columns(model)
    measured = np.array([c in flat for c in velocities])
    qvel = np.empty((len(time), model.nv))
    if not measured.all():
        qvel = estimate_velocity(model, time, qpos)
        hidden = {part_names(model, "joint")[j] for j in unmeasured}
        if hidden:
            notes.append(f"joints without an encoder, whose states are estimated: {', '.join(sorted(hidden))}")
        names = sorted({c.split("/")[1] for c, m in zip(velocities, measured, strict=True) if not m} - hidden)
    if not measured.all() and names:
        notes.append(f"velocity estimated from positions: {', '.join(names[:8])}{', ...' if len(names) > 8 else ''}")
    for i in np.flatnonzero(measured):
        qvel[:, i] = flat[velocities[i]]
    encoders = np.ones(model.nv, bool)
    if unmeasured:
        encoders[model.jnt_dofadr[unmeasured]] = False
        estimate_motion(model, time, ctrl, qpos, qvel, unmeasured)
    return Recording(
        name=name,
        time=time,
        ctrl=ctrl,
        qpos=qpos,
        qvel=qvel,
        qvel_measured=measured,
        split="fit",
        model=model,
        force={c.partition("/")[2]: v for c, v in flat.items() if c.startswith("force/")},
        sensor={c.partition("/")[2]: v for c, v in flat.items() if c.startswith("sensor/")},
        notes=tuple(notes),
        sent=sent,
        held_commands=held,
        qpos_measured=encoders,
    )


def assign_splits(recordings: Sequence[Recording], given: Sequence[Any], where: str) -> list[Recording]:
    """Assign recordings to fit or test.

    Args:
      recordings: all recordings.
      given: split of each in the dataset: "fit", "test" or None.
      where: file, for messages.

    Returns:
      The recordings with their split. If no split is given, the last third of the recordings is held out; a single
      recording is cut at two thirds of its duration. If only some are given, the others are "fit".

    Raises:
      InputError: another value, all recordings in one split, or a single recording that is too short.
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


def split_parts(parts: Sequence[Recording], where: str) -> list[Recording]:
    """Hold out the last third of the samples of the only recording, which is in several parts.

    A part is cut where the last third begins, if both pieces are long enough.

    Raises:
      InputError: a single part that is too short, see `assign_splits`.
    """
    if len(parts) == 1:
        return assign_splits(parts, [None], where)
    total, done = sum(len(part.time) for part in parts), 0
    found: list[Recording] = []
    for part in parts:
        count = len(part.time)
        cut = round(2 / 3 * total) - done
        done += count
        if min(cut, count - cut) >= max(MIN_SAMPLES, total // 20):
            found.append(part.part(slice(None, cut), "fit", f"{part.name} (first part)"))
            found.append(part.part(slice(cut, None), "test", f"{part.name} (rest)"))
        else:
            found.append(replace(part, split="fit" if 2 * cut >= count else "test"))
    if len({one.split for one in found}) == 1:  # one part has nearly everything
        found[-1 if found[0].split == "fit" else 0] = replace(
            found[-1 if found[0].split == "fit" else 0], split="test" if found[0].split == "fit" else "fit"
        )
    return found
