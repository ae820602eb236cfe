"""Tables as formats give them: columns under the names of the log, each table with a clock of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.lists import listed

MAX_COLUMNS = 5_000
"""Most columns of a recording; a robot with a hundred joints and their sensors has fewer than a thousand."""
MAX_LOG_BYTES = 4 << 30
"""Largest size of the numbers of a log that is read as a whole [bytes]."""
_MUJOCO = ("qpos", "qvel", "ctrl")


@dataclass(frozen=True)
class LogTable:
    """A table of a log.

    Attributes:
      label: file, group or topic.
      columns: (K,) numbers by name; groups (K, n) only under names that begin with MuJoCo's qpos, qvel or ctrl.
      units: stated units by column, see `units.UNITS`.
      notes: conversions that the format's reader made.
      text: what is wrong with columns that hold something else than numbers, an error if such a column is used.
    """

    label: str
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    text: Mapping[str, str] = field(default_factory=dict)


def log_table(
    path: Path,
    label: str,
    arrays: Mapping[str, np.ndarray],
    names: Mapping[str, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
    text: Mapping[str, str] | None = None,
) -> LogTable:
    """A table from arrays (K,) or (K, n).

    Args:
      path: file, for messages.
      label: of the table.
      arrays: by name.
      names: of the columns of a group, by the name of the group; "group/0", "group/1", ... elsewhere.
      units: stated units by array.
      text: see `LogTable`.

    Raises:
      InputError: no rows, arrays of different lengths, or too many columns.
    """
    columns: dict[str, np.ndarray] = {}
    stated: dict[str, str] = {}
    for name, array in arrays.items():
        kind = name.partition("/")[0]
        if array.ndim == 2 and array.shape[1] == 1 and kind in ("time", "force", "sensor"):
            array = array[:, 0]
        if array.ndim == 1 or kind in _MUJOCO:
            keys = [name]
            columns[name] = array.astype(np.float64)
        else:
            check_column_count(array.shape[1], path)
            parts = (names or {}).get(name) or [str(i) for i in range(array.shape[1])]
            keys = [f"{name}/{part}" for part in parts]
            if len(set(keys)) != array.shape[1]:
                raise InputError(
                    f"{path}: {name!r} has {array.shape[1]} columns and the {len(parts)} names "
                    f"{listed(parts, quotes=True)}; expected as many, all different"
                )
            columns |= dict(zip(keys, array.astype(np.float64).T, strict=True))
        if units and name in units:
            stated |= dict.fromkeys(keys, units[name])
    check_column_count(len(columns), path)
    lengths = {name: len(values) for name, values in columns.items()}
    if not any(lengths.values()):
        raise InputError(f"{path}: it holds no rows")
    if len(set(lengths.values())) > 1:
        short, long = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        raise InputError(
            f"{path}: columns differ in length ({short!r} has {lengths[short]} rows, {long!r} {lengths[long]}); "
            "sample all of them at the same times"
        )
    return LogTable(label, columns, stated, (), text or {})


def check_column_count(count: int, path: Path) -> None:
    """Refuse more columns than `MAX_COLUMNS`."""
    if count > MAX_COLUMNS:
        raise InputError(f"{path}: has {count} columns, at most {MAX_COLUMNS} are read; keep those of the robot")


def check_log_size(size: int, path: Path) -> None:
    """Refuse a log whose numbers unpack to more than `MAX_LOG_BYTES`."""
    if size > MAX_LOG_BYTES:
        raise InputError(
            f"{path}: its numbers take {size / 2**30:.3g} GiB, at most {MAX_LOG_BYTES >> 30} GiB are read; write the "
            "robot's signals into a file of their own"
        )


def missing_extra(path: Path, extra: str) -> InputError:
    """The error for a file whose library is not installed."""
    return InputError(
        f"{path}: reading it needs the extra {extra!r}: uv add 'btr-mjx[{extra}]', or uv sync --extra {extra}"
    )
