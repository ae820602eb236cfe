"""Config dataclasses and their JSON.

A command's config is one frozen dataclass, from which the command line (tyro), its help and `config.json` are made.
Fields may be bool, int, float, str, Path, None, Literal, tuples, lists, dicts with str keys and other dataclasses.
Floats that are not finite are written as "NaN", "Infinity" and "-Infinity".
"""

import dataclasses
import re
import typing
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs.files import read_json, to_plain

CONFIG_NAME = "config.json"
"""Name of the file in a run folder."""


def config_to_json(config: Any) -> dict[str, Any]:
    """The JSON object of a config.

    Raises:
      TypeError: not a dataclass instance, or a field that JSON would not restore as an equal value (a bug in the
        config).
    """
    if not dataclasses.is_dataclass(config) or isinstance(config, type):
        raise TypeError(f"a config is a dataclass instance, got {type(config).__name__}")
    data = to_plain(config)
    try:
        back = to_plain(config_from_json(type(config), data))
    except InputError as error:
        raise TypeError(f"{type(config).__name__} cannot be saved as JSON: {error}") from error
    if back != data:
        raise TypeError(f"{type(config).__name__} does not come back from JSON: {differences(data, back)}")
    return data


def config_from_json[T](cls: type[T], data: Any) -> T:
    """Build a config from its JSON object; fields that are absent take their defaults.

    Raises:
      InputError: an unknown field (the valid ones are listed), a missing one, or a value of another type.
    """
    import msgspec

    hints = typing.get_type_hints(cls)
    data = dict(data) if isinstance(data, Mapping) else data
    for name in data if isinstance(data, dict) else ():
        if name not in hints:
            raise InputError(f"{name}: no such field; {cls.__name__} has {', '.join(hints)}")
        if data[name] in ("NaN", "Infinity", "-Infinity") and hints[name] in (float, float | None):
            data[name] = float(data[name])
    try:
        return msgspec.convert(data, cls, dec_hook=lambda kind, value: kind(value))  # the hook makes paths
    except msgspec.ValidationError as error:
        place = re.search(r"at `\$\.(\w+)", str(error))
        if place is None:
            raise InputError(f"{cls.__name__}: {error}") from None
        hint, value = hints[place[1]], data[place[1]]
        expected = hint.__name__ if isinstance(hint, type) else str(hint).replace("typing.", "")
        raise InputError(f"{place[1]}: expected {expected}, got {value!r}") from None


def read_config[T](folder: str | Path, cls: type[T]) -> T:
    """Read the config of a run folder.

    Raises:
      InputError: the folder holds no config.json, or not one of this class.
      OSError: the file cannot be read.
    """
    path = Path(folder) / CONFIG_NAME
    data = read_config_json(folder)
    try:
        return config_from_json(cls, data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def read_config_json(folder: str | Path) -> dict[str, Any]:
    """Read config.json as a JSON object, whatever its class; raises as `read_config` does."""
    path = Path(folder) / CONFIG_NAME
    if not path.is_file():
        what = "it holds no config.json" if Path(folder).is_dir() else "there is no such folder"
        raise InputError(f"{folder} is not a run folder: {what}")
    data = read_json(path)
    if not isinstance(data, dict):
        raise DamagedFile(f"{path}: expected a JSON object, got {type(data).__name__}")
    return data


def differences(saved: Mapping[str, Any], new: Mapping[str, Any], ignore: Collection[str] = ()) -> list[str]:
    """Compare two configs' JSON objects field by field.

    Args:
      saved: the config in the folder.
      new: the config just given.
      ignore: names of fields to skip.

    Returns:
      One string per field that differs, e.g. "population: saved 32, now 64".
    """
    shown = lambda data, name: repr(data[name]) if name in data else "(absent)"  # noqa: E731
    return [
        f"{name}: saved {shown(saved, name)}, now {shown(new, name)}"
        for name in {**saved, **new}
        if name not in ignore and (name not in saved or name not in new or _differ(saved[name], new[name]))
    ]


def _differ(a: Any, b: Any) -> bool:
    return a != b or isinstance(a, bool) != isinstance(b, bool)
