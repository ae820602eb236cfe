"""NPZ files: arrays by name, or a `mujoco.sysid.TimeSeries` as its `save_to_disk` writes it.

A TimeSeries has times, data and signal_mapping. Its signals of the state and of commands are called "<joint>_qpos",
"<joint>_qvel" and "<actuator>_ctrl", those of sensors like the sensor. States and commands are often saved in two
files, which one recording may list.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data.columns.model_columns import SUFFIXES
from btr_mjx.gap.data.files.table import LogTable, log_table
from btr_mjx.runs import read_arrays

_KINDS: Mapping[int, str] = {2: "qpos", 3: "qvel", 5: "ctrl"}
"""MuJoCo's array by the number of a SignalType."""


def read_npz(path: Path) -> list[LogTable]:
    """Read an NPZ file."""
    arrays = read_arrays(path)
    if {"times", "data", "signal_mapping"} <= set(arrays):
        return [_time_series(path, arrays)]
    for name, array in arrays.items():
        if array.dtype.kind not in "biuf" or array.ndim not in (1, 2):
            raise InputError(
                f"{path}: array {name!r} has type {array.dtype} and shape {array.shape}; expected numbers, one row a "
                "sample"
            )
    return [log_table(path, path.stem, arrays)]


def count_npz_rows(path: Path) -> int:
    """Length of the array of times; 0 where none has its usual name."""
    with np.load(path, allow_pickle=False) as archive:
        return len(archive["time"]) if "time" in archive else 0


def _time_series(path: Path, arrays: Mapping[str, np.ndarray]) -> LogTable:
    data = arrays["data"]
    try:
        mapping = json.loads(str(arrays["signal_mapping"]))
        parts = {str(name): (int(kind), data[:, np.array(at, int)]) for name, (kind, at) in mapping.items()}
    except (ValueError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise DamagedFile(f"{path}: signal_mapping does not fit data of shape {data.shape} ({error})") from None
    columns: dict[str, np.ndarray] = {"time": arrays["times"]}
    names: dict[str, list[str]] = {}
    for name, (kind, values) in parts.items():
        base = name.removesuffix(f"_{_KINDS[kind]}") if kind in _KINDS else name
        suffixes = [s[kind - 2] for s in SUFFIXES.values() if kind in (2, 3) and len(s[kind - 2]) == values.shape[1]]
        if suffixes:  # of a free or ball joint, whose position and velocity make one group
            columns[base] = values if base not in columns else np.concatenate([columns[base], values], axis=1)
            names[base] = [*names.get(base, []), *suffixes[0]]
        else:
            key = f"{base}_{_KINDS[kind]}" if kind in _KINDS else base
            columns[key] = values[:, 0] if values.shape[1] == 1 else values
    return log_table(path, path.stem, columns, names)
