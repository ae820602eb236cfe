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
from btr_mjx.gap.data.columns import check_names, control_columns, read_columns, state_columns, ungroup_columns
from btr_mjx.gap.data.long_files import Advance, Share, read_stretches
from btr_mjx.gap.data.plausible import check_sizes, check_span
from btr_mjx.gap.data.samples import check_time, complete_rows, estimate_velocity, normalise_quaternions
from btr_mjx.gap.data.unmeasured import estimate_motion, unmeasured_joints
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
    qpos_measured: np.ndarray | None = None

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


def read_recording(
    folder: Path,
    row: Mapping[str, Any],
    base: mujoco.MjModel,
    where: str,
    notes: list[str],
    share: Share | None = None,
    advance: Advance = lambda count: None,
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

    Returns:
      The recording, or stretches of it, with split "fit".

    Raises:
      InputError: see `dataset.load`.
    """
    check_keys(row, ("file", "split", "model", "overrides", "name"), where, notes)
    file = file_inside(row, "file", folder, where)
    if not file.is_file():
        raise InputError(f"{where}: there is no file {file}")
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
    name = _name(row, file.stem, where)
    if share is None:
        recording = make_recording(read_columns(file), model, str(file), name)
        advance(file.stat().st_size)
        return [recording]
    return [
        make_recording(
            columns, model, f"{file} from {columns['time'][0]:.6g} s on", f"{name} at {columns['time'][0]:.6g} s"
        )
        for columns in read_stretches(file, share, model, notes, advance)
    ]


def _name(row: Mapping[str, Any], default: str, where: str) -> str:
    name = row.get("name", default)
    if not isinstance(name, str) or not 0 < len(name) <= 200 or not name.isprintable():
        raise InputError(f"{where}: name = {name!r}: expected a text of one line, at most 200 characters")
    return name


def make_recording(columns: Mapping[str, np.ndarray], model: mujoco.MjModel, where: str, name: str) -> Recording:
    """Build a recording from the columns of a table.

    Args:
      columns: arrays by name, as `columns.read_columns` returns them.
      model: the recording's model.
      where: file, for messages.
      name: the recording's name.

    Raises:
      InputError: missing or unknown columns, time that does not increase, gaps of missing values, quaternions that
        are not of unit length, too few samples.
    """
    flat = ungroup_columns(columns, model, where)
    ignored = check_names(flat, model, where)
    unmeasured = unmeasured_joints(flat, model, where)
    notes = [f"columns without a use: {', '.join(ignored[:8])}{', ...' if len(ignored) > 8 else ''}"] if ignored else []
    positions, velocities = state_columns(model)
    measured = np.array([c in flat for c in velocities])
    positions = [c for c in positions if c in flat]
    needed = ["time", *positions, *control_columns(model), *(c for c in velocities if c in flat)]
    sound = complete_rows(flat, needed, where, notes)
    flat = {key: value[sound] for key, value in flat.items()}
    time = flat["time"]
    check_time(time, where)
    check_span(time, where)
    check_sizes(flat, needed, where)
    if len(time) < MIN_SAMPLES:
        raise InputError(f"{where}: {len(time)} samples are too short for a window; expected at least {MIN_SAMPLES}")
    qpos = np.tile(model.qpos0, (len(time), 1))
    seen_q = np.delete(np.arange(model.nq), model.jnt_qposadr[unmeasured])
    qpos[:, seen_q] = np.stack([flat[c] for c in positions], axis=1)
    ctrl = np.array([flat[c] for c in control_columns(model)]).reshape(model.nu, len(time)).T
    normalise_quaternions(qpos, model, where)
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
