"""One recording: a table of measurements read with the model that is believed of it, and the split of several.

What a file must hold is in `columns`; `dataset` reads the dataset around it.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from btr_mjx.errors import InputError, one_line
from btr_mjx.gap.data.columns import check_names, control_columns, read_columns, spread, state_columns
from btr_mjx.gap.data.samples import check_time, estimate_velocity, normalise, sound_rows
from btr_mjx.gap.data.toml_tables import check_keys, file_name, is_number
from btr_mjx.models import set_values

MIN_SAMPLES = 20
"""A recording shorter than this holds no window."""

Split = Literal["fit", "test"]


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
        model = _compiled(path)
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo does not load this model: {one_line(error)}") from None
    if model.nu == 0 or model.njnt == 0:
        raise InputError(f"{path}: the model has {model.njnt} joints and {model.nu} actuators; expected some of both")
    return model, path.read_text(encoding="utf-8")


def _compiled(path: Path) -> mujoco.MjModel:
    """Without MuJoCo's short cuts for single bodies: they hold for this inertia only, and effects change it."""
    model = mujoco.MjModel.from_xml_path(str(path))
    if not model.body_simple[1:].any():
        return model
    spec = mujoco.MjSpec.from_file(str(path))
    for body in spec.bodies:
        body.simple = 0
    return spec.compile()


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
        model = copy.deepcopy(model)
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
