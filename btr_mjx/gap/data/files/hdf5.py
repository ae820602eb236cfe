"""HDF5 files: every group with a time of its own is a table.

Columns are the numeric datasets of a group (K,) or (K, n), and the fields of compound datasets. A group without time
takes that of the nearest group above whose length agrees. Names of the n columns come from an attribute `names`,
`columns` or `joint_names`, or from a dataset of texts of that name beside it; units from an attribute `units`.
Links to other files and data stored outside the file are not followed.
"""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import DamagedFile, InputError, one_line
from btr_mjx.gap.data.columns.units import known_unit, stated_unit
from btr_mjx.gap.data.columns.words import TIME, words
from btr_mjx.gap.data.files.table import LogTable, check_log_size, log_table, missing_extra
from btr_mjx.gap.data.lists import listed
from btr_mjx.runs import MAX_TABLE_BYTES, check_regular

Group = Mapping[str, tuple[np.ndarray, str | None, Sequence[str] | None]]
"""Arrays by name, each with its unit and the names of its columns, if these are stated."""
_NAMES = ("joint_names", "names", "columns", "actuator_names")
_MAX_OBJECTS = 20_000


def read_hdf5(path: Path) -> list[LogTable]:
    """Read the tables of an HDF5 file."""
    try:
        import h5py
    except ImportError:
        raise missing_extra(path, "hdf5") from None
    check_regular(path, MAX_TABLE_BYTES)
    try:
        with h5py.File(path, "r") as file:
            groups = _datasets(file, h5py.Dataset, path)
            check_log_size(sum(int(d.nbytes) for g in groups.values() for d in g.values()), path)
            return _tables(path, {name: _read_group(group) for name, group in groups.items()})
    except InputError:
        raise
    except Exception as error:  # h5py raises many types of errors for damaged bytes
        raise DamagedFile(f"{path}: not a readable HDF5 file ({one_line(error)})") from None


def count_hdf5_rows(path: Path) -> int:
    """Length of the longest dataset."""
    import h5py

    with h5py.File(path, "r") as file:
        groups = _datasets(file, h5py.Dataset, path)
        return max((int(d.shape[0]) for group in groups.values() for d in group.values()), default=0)


def _datasets(file: Any, kind: Any, path: Path) -> dict[str, dict[str, Any]]:
    """The datasets of each group; soft and external links are not visited."""
    found: dict[str, dict[str, Any]] = {}
    count = itertools.count(1)

    def visit(name: str, item: Any) -> None:
        if next(count) > _MAX_OBJECTS:
            raise InputError(
                f"{path}: holds more than {_MAX_OBJECTS} groups and datasets; write the robot's signals only"
            )
        if isinstance(item, kind) and item.shape is not None and len(item.shape) in (1, 2):
            if item.external or item.is_virtual:
                raise InputError(f"{path}: dataset {name!r} is stored in another file; copy its numbers into this one")
            group, _, last = name.rpartition("/")
            found.setdefault(group, {})[last] = item

    file.visititems(visit)
    return found


def _read_group(group: Mapping[str, Any]) -> Group:
    texts = {name: _texts(item[...]) for name, item in group.items() if name in _NAMES and item.dtype.kind in "OSU"}
    arrays: dict[str, tuple[np.ndarray, str | None, Sequence[str] | None]] = {}
    for name, item in group.items():
        if item.dtype.kind in "biuf":
            unit = next((str(_text(item.attrs[key])) for key in ("units", "unit") if key in item.attrs), "")
            own = next((_texts(np.atleast_1d(item.attrs[key])) for key in _NAMES if key in item.attrs), None)
            width = item.shape[1] if len(item.shape) == 2 else 1
            beside = next((found for found in texts.values() if len(found) == width), None)
            arrays[name] = item[...], known_unit(unit), own or beside
        elif item.dtype.names:
            table = item[...]
            for part in item.dtype.names:
                if table[part].dtype.kind in "biuf" and table[part].ndim in (1, 2):
                    arrays[f"{name}/{part}"] = table[part], None, None
    return arrays


def _text(value: Any) -> Any:
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _texts(values: Any) -> list[str]:
    return [str(_text(value)) for value in np.ravel(values)]


def _is_time(name: str) -> bool:
    named = words(stated_unit(name.rpartition("/")[2])[0])
    return bool(named) and named[-1] in TIME


def _tables(path: Path, groups: Mapping[str, Group]) -> list[LogTable]:
    times = {
        group: {name: entry for name, entry in arrays.items() if _is_time(name) and entry[0].ndim == 1}
        for group, arrays in groups.items()
    }
    if not any(times.values()):
        held = [f"{group}/{name}".strip("/") for group, arrays in groups.items() for name in arrays]
        raise InputError(
            f"{path}: no dataset is called time or timestamp; it holds {listed(held, quotes=True) or 'no numbers'}"
        )
    tables = []
    for group, arrays in groups.items():
        for length in sorted({len(entry[0]) for name, entry in arrays.items() if name not in times[group]}):
            clock = _clock(group, length, times)
            if clock is None:
                continue
            own = {n: e for n, e in arrays.items() if len(e[0]) == length and n not in times[group]} | clock
            # Groups are part of a column's name, but MuJoCo's own names stay.
            own = {
                name if name in ("qpos", "qvel", "ctrl", "time") else f"{group}/{name}".lstrip("/"): entry
                for name, entry in own.items()
            }
            names = {name: parts for name, (array, _, parts) in own.items() if parts and array.ndim == 2}
            units = {name: unit for name, (_, unit, _) in own.items() if unit}
            tables.append(log_table(path, group, {name: entry[0] for name, entry in own.items()}, names, units))
    return tables


def _clock(group: str, length: int, times: Mapping[str, Group]) -> dict[str, Any] | None:
    """The times of a group, or those of the nearest group above, with this many samples."""
    while True:
        found = {name: entry for name, entry in times.get(group, {}).items() if len(entry[0]) == length}
        if found:
            return found
        if not group:
            return None
        group = group.rpartition("/")[0]
