"""Settings as a program gives them, and as the flags that a person would type."""

import dataclasses
import numbers
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from btr_mjx.errors import InputError
from btr_mjx.models import nearest_names


def typed_settings(config: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that were given in Python, with the types of a config's fields, as a command line would give them.

    A text may stand for a path, and one value or a list for a tuple.

    Raises:
      InputError: a name that is no field, a value of another type, or none of the choices.
    """
    hints = get_type_hints(config)
    for name in given:
        if name not in hints:
            raise InputError(f"there is no setting {name!r}; nearest: {nearest_names(name, [*hints])}")
    return {name: _typed(name, value, hints[name]) for name, value in given.items()}


def _typed(name: str, value: Any, hint: Any) -> Any:
    """A value as one of the types of a field."""
    kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    for kind in kinds:
        inner = get_args(kind)
        if get_origin(kind) is tuple and isinstance(value, (list, tuple, str, Path)):
            return tuple(_typed(name, one, inner[0]) for one in ([value] if isinstance(value, (str, Path)) else value))
        if get_origin(kind) is Literal and isinstance(value, str) and value in inner:
            return value
        if kind is Path and isinstance(value, (str, Path)):
            return Path(value)
        number = {int: numbers.Integral, float: numbers.Real}.get(kind)
        if number is not None and isinstance(value, number) and not isinstance(value, bool):
            return kind(value)
        if kind in (bool, str, type(None)) and isinstance(value, kind):
            return value
    words = " or ".join(", ".join(map(repr, get_args(k))) if get_origin(k) is Literal else _kind(k) for k in kinds)
    raise InputError(f"{name}: got {value!r}, expected {words}")


def _kind(kind: Any) -> str:
    """A type in words."""
    known = {int: "a whole number", float: "a number", bool: "True or False", str: "a text", Path: "a path"}
    return f"a tuple of {get_args(kind)[0].__name__}" if get_origin(kind) is tuple else known.get(kind, "None")


def flags_of(config: Any, default: Any, leave_out: Sequence[str] = ()) -> list[str]:
    """Flags that make a flat config of a default one, such as ["--trials", "4", "--no-progress"]."""
    words: list[str] = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name in leave_out or value == getattr(default, field.name) or value is None:
            continue
        flag = field.name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", *map(str, value if isinstance(value, tuple) else [value])]
    return words
