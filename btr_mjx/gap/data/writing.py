"""Writing of dataset folders that `dataset.load` reads."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import control_columns, state_columns
from btr_mjx.gap.data.control import Interpolation
from btr_mjx.gap.data.dataset import DATASET_FILE
from btr_mjx.gap.data.recordings.noise import Noise, noise_as_table
from btr_mjx.gap.data.recordings.recording import Recording
from btr_mjx.models import PathParameter
from btr_mjx.runs import write_arrays, write_table, write_text

Format = Literal["npz", "csv", "parquet"]
"""Formats in which recordings are written."""


def recording_columns(recording: Recording) -> dict[str, np.ndarray]:
    """The columns (K,) of the table of a recording; velocities only where they were measured."""
    positions, velocities = state_columns(recording.model)
    columns = {"time": recording.time}
    columns |= dict(zip(control_columns(recording.model), recording.ctrl.T, strict=True))
    model = recording.model
    seen = np.repeat(recording.sensed[model.jnt_dofadr], np.diff([*model.jnt_qposadr, model.nq]))
    position = zip(positions, recording.qpos.T, seen, strict=True)
    columns |= {name: values for name, values, measured in position if measured}
    velocity = zip(velocities, recording.qvel.T, recording.qvel_measured & recording.sensed, strict=True)
    columns |= {name: values for name, values, measured in velocity if measured}
    columns |= {f"force/{name}": values for name, values in recording.force.items()}
    columns |= {f"sensor/{name}": values for name, values in recording.sensor.items()}
    return columns


@dataclass(frozen=True)
class DatasetDescription:
    """Content of dataset.toml besides the recordings.

    Attributes:
      parameters: parameters that may be refitted.
      interpolation: of the command between samples.
      tolerances: 1 sigma of residual calibration errors, by effect; None for the defaults of the effects.
      noise: of the sensors; None if it is to be estimated when read.
      models: MJCF texts of recordings that have their own model, by recording name.
      overrides: model numbers that differ in a recording, by recording name and path.
    """

    parameters: Sequence[PathParameter] = ()
    interpolation: Interpolation = "linear"
    tolerances: Mapping[str, float] | None = None
    noise: Noise | None = None
    models: Mapping[str, str] | None = None
    overrides: Mapping[str, Mapping[str, float]] | None = None


def save_dataset(
    folder: str | Path,
    xml: str,
    recordings: Sequence[Recording],
    description: DatasetDescription = DatasetDescription(),
    *,
    file_format: Format = "npz",
) -> Path:
    """Write a dataset folder.

    Args:
      folder: created if absent.
      xml: MJCF text of the believed model.
      recordings: with distinct names. Their models only provide column names.
      description: further content of dataset.toml.
      file_format: of the recording files.

    Returns:
      The path of dataset.toml.

    Raises:
      InputError: two recordings have the same name.
      OSError: the folder cannot be written to.
    """
    folder, noise = Path(folder), description.noise
    models, overrides = description.models or {}, description.overrides or {}
    names = [recording.name for recording in recordings]
    if len(set(names)) < len(names):
        raise InputError(f"recordings: got the names {', '.join(names)}, expected different ones")
    write_text(folder / "model.xml", xml)
    lines = ["[model]", 'file = "model.xml"', "", "[control]", *_pairs({"interpolation": description.interpolation})]
    noise_table = None if noise is None else noise_as_table(noise, recordings[0].model)
    for title, table in (("tolerances", description.tolerances), ("noise", noise_table)):
        if table:
            lines += ["", f"[{title}]", *_pairs(table)]
    for believed in description.parameters:
        entry = {"name": believed.name, "path": list(believed.paths), "bounds": [believed.low, believed.high]}
        lines += ["", "[[parameter]]", *_pairs(entry | {"relative": believed.relative})]
    for recording in recordings:
        file = f"{recording.name}.{file_format}"
        columns = recording_columns(recording)
        if file_format == "npz":
            write_arrays(folder / file, columns)
        else:
            write_table(folder / file, columns)
        row: dict[str, Any] = {"file": file, "split": recording.split}
        if recording.name in models:
            row["model"] = own = f"{recording.name}.xml"
            write_text(folder / own, models[recording.name])
        lines += ["", "[[recording]]", *_pairs(row)]
        if overrides.get(recording.name):
            lines += [f"overrides = {{ {', '.join(_pairs(overrides[recording.name]))} }}"]
    write_text(folder / DATASET_FILE, "\n".join(lines) + "\n")
    return folder / DATASET_FILE


def _pairs(table: Mapping[str, Any]) -> list[str]:
    return [f"{key if key.isidentifier() else json.dumps(key)} = {_value(value)}" for key, value in table.items()]


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in value)}]"
    return json.dumps(value if isinstance(value, str | bool) else float(value), ensure_ascii=False)
