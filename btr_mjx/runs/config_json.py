"""Config dataclasses and their JSON.

A command's config is one frozen dataclass, from which the command line (tyro), its help and `config.json` are made.
Fields may be bool, int, float, str, Path, None, Literal, Enum (by name), tuples, lists, dicts with str keys, other
dataclasses, and unions of these. Floats that are not finite are written as "NaN", "Infinity" and "-Infinity".
"""

import collections.abc
import dataclasses
import enum
import types
import typing
from collections.abc import Callable, Collection, Mapping
from pathlib import Path, PurePath
from typing import Any

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs.files import read_json, to_plain

CONFIG_NAME = "config.json"
"""Name of the file in a run folder."""

ABSENT = "(absent)"
"""How messages show a field that one of two configs does not have."""


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
    return _decode(cls, data, "")


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
      ignore: dotted names of fields to skip, with all fields below them ("out", "ga.verbose").

    Returns:
      One string per field that differs, e.g. "ga.population: saved 32, now 64".
    """
    left, right = _flatten(saved), _flatten(new)
    found = []
    for name in [*left, *(name for name in right if name not in left)]:
        if any(name == skip or name.startswith(f"{skip}.") for skip in ignore):
            continue
        a, b = left.get(name, ABSENT), right.get(name, ABSENT)
        if a != b or isinstance(a, bool) != isinstance(b, bool):
            found.append(f"{name}: saved {_show(a)}, now {_show(b)}")
    return found


def _show(value: Any) -> str:
    return value if value is ABSENT else repr(value)


def _flatten(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in data.items():
        if isinstance(value, Mapping) and value:
            flat |= _flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _decode(hint: Any, data: Any, where: str) -> Any:
    """Read `data` as the annotated type `hint`; `where` is the dotted name for messages."""
    while isinstance(hint, typing.TypeAliasType):
        hint = hint.__value__
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _decode(args[0], data, where)
    if origin in (typing.Union, types.UnionType):
        return _decode_union(args, data, where)
    if origin is typing.Literal:
        for choice in args:
            plain = choice.name if isinstance(choice, enum.Enum) else choice
            if plain == data and isinstance(plain, bool) == isinstance(data, bool):
                return choice
        raise _mismatch(where, "one of " + ", ".join(map(repr, args)), data)
    kind = origin or hint
    if kind is Any or kind is object:
        return data
    if kind is None or kind is type(None):
        return _require(data is None, None, where, "null", data)
    if isinstance(kind, type):
        if issubclass(kind, enum.Enum):
            known = isinstance(data, str) and data in kind.__members__
            return _require(known, lambda: kind[data], where, "one of " + ", ".join(kind.__members__), data)
        if dataclasses.is_dataclass(kind):
            return _decode_dataclass(kind, data, where)
        if issubclass(kind, tuple):
            return _decode_tuple(args, data, where)
        if kind is list or kind is collections.abc.Sequence:
            build: Any = list if kind is list else tuple
            item = args[0] if args else Any
            return _require(isinstance(data, list), lambda: build(_items(item, data, where)), where, "a list", data)
        if kind is dict or kind is collections.abc.Mapping:
            item = args[1] if args else Any
            good = isinstance(data, dict)
            return _require(
                good, lambda: {k: _decode(item, v, _join(where, k)) for k, v in data.items()}, where, "an object", data
            )
        if issubclass(kind, PurePath):
            return _require(isinstance(data, str), lambda: kind(data), where, "a path", data)
        if kind is float:
            number = isinstance(data, int | float) and not isinstance(data, bool)
            number = number or (isinstance(data, str) and data in ("NaN", "Infinity", "-Infinity"))
            return _require(number, lambda: float(data), where, "a number", data)
        if kind in (bool, int, str):
            return _require(type(data) is kind, data, where, f"{kind.__name__}", data)
    raise InputError(f"{where or 'config'}: type {hint} is not supported in a config")


def _decode_union(members: tuple[Any, ...], data: Any, where: str) -> Any:
    found, problems = [], []
    for member in members:
        try:
            found.append(_decode(member, data, where))
        except InputError as error:
            problems.append(str(error))
    if not found:
        raise InputError("; ".join(problems))
    # The JSON holds no class names: dataclasses are told apart by their fields.
    exact = [one for one in found if dataclasses.is_dataclass(one) and set(to_plain(one)) == set(data)]
    if len(exact) > 1:
        raise InputError(f"{where}: {' and '.join(type(one).__name__ for one in exact)} have the same fields")
    return exact[0] if exact else found[0]


def _decode_dataclass(cls: Any, data: Any, where: str) -> Any:
    if not isinstance(data, dict):
        raise _mismatch(where, f"an object ({cls.__name__})", data)
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    for name in data:
        if name not in fields:
            raise InputError(f"{_join(where, name)}: no such field; {cls.__name__} has {', '.join(fields)}")
    for name, field in fields.items():
        optional = field.default is not dataclasses.MISSING or field.default_factory is not dataclasses.MISSING
        if name not in data and not optional:
            raise InputError(f"{_join(where, name)}: missing, and {cls.__name__} has no default for it")
    return cls(**{name: _decode(hints[name], value, _join(where, name)) for name, value in data.items()})


def _decode_tuple(args: tuple[Any, ...], data: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(data, list):
        raise _mismatch(where, "a list", data)
    if not args or args[-1] is Ellipsis:
        return tuple(_items(args[0] if args else Any, data, where))
    if len(args) != len(data):
        raise _mismatch(where, f"a list of {len(args)}", data)
    return tuple(_decode(hint, item, f"{where}[{i}]") for i, (hint, item) in enumerate(zip(args, data, strict=True)))


def _items(hint: Any, data: list[Any], where: str) -> list[Any]:
    return [_decode(hint, item, f"{where}[{i}]") for i, item in enumerate(data)]


def _require(good: bool, value: Any, where: str, expected: str, got: Any) -> Any:
    if not good:
        raise _mismatch(where, expected, got)
    return value() if isinstance(value, Callable) else value  # type: ignore[arg-type]


def _mismatch(where: str, expected: str, got: Any) -> InputError:
    return InputError(f"{where or 'config'}: expected {expected}, got {got!r}")


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name
