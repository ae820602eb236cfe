"""Digests of what a result depends on: equal content, equal digest, in any process and on any machine.

Text, numbers and arrays count by value, dataclasses by their fields and methods, functions by their compiled code and
by what they refer to, those of this package by their names. Files that an MJCF names (included MJCF, meshes, textures)
count by their bytes.
"""

import dataclasses
import functools
import hashlib
import pickle
import re
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.robots import Robot

_FILE_ATTRIBUTE = re.compile(r"\sfile\w*\s*=\s*[\"']([^\"']+)[\"']")
_FOLDER_ATTRIBUTE = re.compile(r"\s(?:meshdir|texturedir|assetdir)\s*=\s*[\"']([^\"']+)[\"']")


def digest_of(*values: Any) -> str:
    """SHA-256 of values, in hexadecimal.

    Args:
      *values: see the module's docstring; other objects count by their pickle.

    Raises:
      InputError: an object that cannot be pickled.
    """
    total = hashlib.sha256()
    for part in _parts(values):
        total.update(b"%d:" % len(part) + part)  # lengths keep ("ab", "c") apart from ("a", "bc")
    return total.hexdigest()


def files_digest(robot: Robot) -> str:
    """SHA-256 of the files that a robot's MJCF names and that exist, with their names."""
    found: dict[str, bytes] = {}
    left, folders = [robot.render(robot.nominal_simulation)], {""}
    while left:
        text = left.pop()
        folders |= set(_FOLDER_ATTRIBUTE.findall(text))
        for name in _FILE_ATTRIBUTE.findall(text):
            for place in sorted(folders):
                path = Path(robot.folder or ".", place, name)
                key = (Path(place) / name).as_posix()
                if key not in found and path.is_file():
                    found[key] = path.read_bytes()
                    left += [found[key].decode("utf-8", "replace")] if path.suffix == ".xml" else []
    return digest_of(sorted(found.items()))


def robot_digest(robot: Robot) -> str:
    """SHA-256 of everything in a robot that its behaviours depend on; not of its name or of where its files lie."""
    fields = {field.name: getattr(robot, field.name) for field in dataclasses.fields(robot)}
    for place in ("name", "folder", "template_path", "fitness"):
        del fields[place]
    return digest_of(fields, files_digest(robot))


def _parts(value: Any, seen: tuple[int, ...] = ()) -> Iterator[bytes]:
    """The bytes that stand for a value, one part after the other; `seen` are the functions that lead here."""
    if value is None or value is Ellipsis or isinstance(value, bool | int | float | complex | str | bytes):
        yield repr(value).encode()
    elif isinstance(value, np.ndarray | np.generic) and not np.asarray(value).dtype.hasobject:
        array = np.asarray(value)
        yield f"{array.dtype.str}{array.shape}".encode()
        yield array.tobytes()
    elif isinstance(value, Mapping):
        yield b"mapping %d" % len(value)
        for key in sorted(value, key=repr):
            yield from _parts((key, value[key]), seen)
    elif isinstance(value, tuple | list):
        yield b"sequence %d" % len(value)
        for item in value:
            yield from _parts(item, seen)
    elif isinstance(value, set | frozenset):
        yield from _parts(sorted(digest_of(item) for item in value))
    elif isinstance(value, functools.partial):
        yield from _parts((value.func, value.args, value.keywords), seen)
    elif isinstance(value, types.FunctionType):
        yield from _function_parts(value, seen)
    elif isinstance(value, type | types.ModuleType | types.BuiltinFunctionType | np.ufunc):
        yield f"{getattr(value, '__module__', '')}.{value.__name__}".encode()
    elif dataclasses.is_dataclass(value):
        yield from _parts(type(value))
        yield from _parts({field.name: getattr(value, field.name) for field in dataclasses.fields(value)}, seen)
        if type(value).__module__.partition(".")[0] != "btr_mjx":
            methods = {name: item for name, item in vars(type(value)).items() if isinstance(item, types.FunctionType)}
            written = {name: item for name, item in methods.items() if item.__code__.co_filename != "<string>"}
            yield from _parts(written, seen)
    else:
        try:
            yield pickle.dumps(value)
        except Exception as error:  # pickle raises errors of many types
            raise InputError(f"{value!r}: has no content that can be compared ({error}); use a dataclass") from None


def _function_parts(function: types.FunctionType, seen: tuple[int, ...]) -> Iterator[bytes]:
    """A function of this package counts by its name, another one by its code and by what that refers to."""
    yield f"{function.__module__}.{function.__qualname__}".encode()
    if function.__module__.partition(".")[0] == "btr_mjx" or id(function) in seen:
        return
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    yield from _parts((function.__defaults__, function.__kwdefaults__, cells), (*seen, id(function)))
    codes = [function.__code__]
    for code in codes:
        codes += [item for item in code.co_consts if isinstance(item, types.CodeType)]
        constants = [item for item in code.co_consts if not isinstance(item, types.CodeType)]
        yield from _parts((code.co_code, constants, code.co_names, code.co_varnames))
        for name in code.co_names:
            if name in function.__globals__:
                yield name.encode()
                yield from _parts(function.__globals__[name], (*seen, id(function)))
