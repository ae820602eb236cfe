"""Digests of Python values: whether two runs were given the same robot, data or functions."""

import dataclasses
import hashlib
import inspect
import sys
from collections.abc import Callable, Mapping
from enum import Enum
from functools import partial
from pathlib import PurePath
from types import CodeType, FunctionType, MethodType
from typing import Any

import numpy as np


def content_digest(*values: Any, unknown: Callable[[Any], bytes] = lambda value: b"") -> str:
    """SHA-256 of the content of values, in hex.

    Equal content gives equal digests in every process. Arrays, models of MuJoCo, dataclasses, containers and other
    objects are read through. A function is its source text where that is known, else its code; one of this package is
    its name. A path is its file name.

    Args:
      values: what is digested.
      unknown: bytes for an object whose content cannot be read; its type alone counts by default.

    Raises:
      RecursionError: a value that holds itself.
    """
    digest = hashlib.sha256()
    for value in values:
        _add(digest, value, unknown)
    return digest.hexdigest()


def _add(digest: "hashlib._Hash", value: Any, unknown: Callable[[Any], bytes]) -> None:
    add = lambda part: _add(digest, part, unknown)  # noqa: E731
    digest.update(f"{type(value).__module__}.{type(value).__qualname__}:".encode())
    if isinstance(value, (str, bytes, bool, int, float, complex, type(None), Enum)):
        digest.update(repr(value).encode() + b";")
    elif isinstance(value, PurePath):
        add(value.name)
    elif isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value)
        digest.update(f"{array.dtype}{array.shape}".encode())
        if array.dtype.hasobject:
            add(array.tolist())
        else:
            digest.update(np.ascontiguousarray(array).data)
    elif _is_model(value):
        mujoco = sys.modules["mujoco"]
        binary = np.empty(mujoco.mj_sizeModel(value), np.uint8)
        mujoco.mj_saveModel(value, None, binary)
        digest.update(binary.data)
    elif isinstance(value, Mapping):
        add([part for pair in value.items() for part in pair])
    elif isinstance(value, (list, tuple)):
        digest.update(str(len(value)).encode())
        for part in value:
            add(part)
    elif isinstance(value, (set, frozenset)):
        add(sorted(value, key=repr))
    elif isinstance(value, FunctionType):
        add(_text(value))
        add([value.__defaults__, value.__kwdefaults__, [cell.cell_contents for cell in value.__closure__ or ()]])
    elif isinstance(value, CodeType):
        add([value.co_code, value.co_consts, value.co_names])
    elif isinstance(value, MethodType):
        add([value.__func__, value.__self__])
    elif isinstance(value, partial):
        add([value.func, value.args, value.keywords])
    elif isinstance(value, type):
        digest.update(f"{value.__module__}.{value.__qualname__}".encode())
    elif dataclasses.is_dataclass(value):  # their other attributes are caches
        add([getattr(value, field.name) for field in dataclasses.fields(value)])
    elif hasattr(value, "__dict__"):
        add(vars(value))
    else:
        digest.update(unknown(value))


def _text(function: FunctionType) -> Any:
    if function.__module__.split(".")[0] == __name__.split(".")[0]:
        return f"{function.__module__}.{function.__qualname__}"
    try:
        return inspect.getsource(function)
    except (OSError, TypeError):
        return function.__code__


def _is_model(value: Any) -> bool:
    mujoco = sys.modules.get("mujoco")
    return mujoco is not None and isinstance(value, mujoco.MjModel)
