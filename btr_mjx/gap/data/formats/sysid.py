"""`mujoco.sysid.TimeSeries`, as its `save_to_disk` writes it: an .npz file with times, data and signal_mapping.

Signals of the state and of commands have the names "<joint>_qpos", "<joint>_qvel" and "<actuator>_ctrl", those of
sensors the sensor's name. States and commands are often saved in two files, which one recording may list.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from btr_mjx.errors import DamagedFile
from btr_mjx.gap.data.columns import SUFFIXES
from btr_mjx.gap.data.tables import LogTable, log_table

_KINDS: Mapping[int, str] = {2: "qpos", 3: "qvel", 5: "ctrl"}
"""MuJoCo's array by the number of a SignalType."""


def is_time_series(arrays: Mapping[str, np.ndarray]) -> bool:
    """Whether the arrays of an .npz file are a TimeSeries."""
    return "times" in arrays and "data" in arrays and "signal_mapping" in arrays


def time_series_table(path: Path, arrays: Mapping[str, np.ndarray]) -> LogTable:
    """The table of a TimeSeries.

    Args:
      path: file, for messages.
      arrays: of the file.

    Raises:
      DamagedFile: a mapping that does not fit the data.
    """
    data = arrays["data"]
    try:
        mapping = json.loads(str(arrays["signal_mapping"]))
        signals = {str(name): (int(kind), np.array(index, int)) for name, (kind, index) in mapping.items()}
        parts = {name: (kind, data[:, index]) for name, (kind, index) in signals.items()}
    except (ValueError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise DamagedFile(f"{path}: signal_mapping does not fit data of shape {data.shape} ({error})") from None
    columns: dict[str, np.ndarray] = {"time": arrays["times"]}
    names: dict[str, list[str]] = {}
    for name, (kind, values) in parts.items():
        base = name.removesuffix(f"_{_KINDS[kind]}") if kind in _KINDS else name
        key = f"{base}_{_KINDS[kind]}" if kind in _KINDS else base
        suffix = next(
            (s[kind - 2] for s in SUFFIXES.values() if kind in (2, 3) and len(s[kind - 2]) == values.shape[1]), None
        )
        if suffix:
            columns[base] = values if base not in columns else np.concatenate([columns[base], values], axis=1)
            names[base] = [*names.get(base, []), *suffix]
        else:
            columns[key] = values[:, 0] if values.shape[1] == 1 else values
    return log_table(path, path.stem, columns, names)
