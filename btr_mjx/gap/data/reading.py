"""A [[recording]] row of dataset.toml: its files, its own model, and what is made of them."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import control_columns, state_columns
from btr_mjx.gap.data.logs import LogOptions, is_log, read_log
from btr_mjx.gap.data.long_files import Advance, Share, read_stretches
from btr_mjx.gap.data.model_file import load_model
from btr_mjx.gap.data.recording import MIN_SAMPLES, EmptyRecording, Recording, make_recordings
from btr_mjx.models import set_values
from btr_mjx.runs import check_keys, file_inside, is_number


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
