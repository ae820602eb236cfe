"""Digests of Python values: whether two runs were given the same robot, data or functions."""

import dataclasses
import hashlib
import sys
from collections.abc import Callable, Mapping
from enum import Enum
from functools import partial
from pathlib import PurePath
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from btr_mjx.errors import InputError

_PLACES = ("paths", "npaths", "nbuffer")
"""Fields of a model with the paths of its files, and sizes that depend on them."""

_PACKAGE = __name__.partition(".")[0]


def _refused(value: Any) -> bytes:
    raise InputError(f"{value!r}: has no content that can be compared; use a dataclass")


def content_digest(*values: Any, unknown: Callable[[Any], bytes] = _refused) -> str:
    """SHA-256 of the content of values, in hex: equal content, equal digest, in every process.

    Arrays, models of MuJoCo, dataclasses, containers and other objects are read through. A function is its code and
    what that refers to; one of this package is its name. A path is its file name.

    Args:
      values: what is digested.
      unknown: bytes for an object whose content cannot be read.

    Raises:
      InputError: there is such an object, by default.
      RecursionError: a container that holds itself.
    """
    digest = _Digest(unknown)
    for value in values:
        digest.add(value)
    return digest.total.hexdigest()


class _Digest:
    def __init__(self, unknown: Callable[[Any], bytes]) -> None:
        self.total, self.unknown, self.functions = hashlib.sha256(), unknown, set[int]()

    def add(self, value: Any) -> None:
        self.total.update(f"{type(value).__module__}.{type(value).__qualname__}:".encode())
        if isinstance(value, (str, bytes, bool, int, float, complex, type(None), type(...), Enum)):
            self._text(repr(value))
        elif isinstance(value, PurePath):
            self._text(value.name)
        elif isinstance(value, (np.ndarray, np.generic)):
            self._array(np.asarray(value))
        elif _is_model(value):
            self._model(value)
        elif isinstance(value, Mapping):
            self.add([part for key in sorted(value, key=repr) for part in (key, value[key])])
        elif isinstance(value, (list, tuple)):
            self._text(str(len(value)))
            for part in value:
                self.add(part)
        elif isinstance(value, (set, frozenset)):
            self.add(sorted(value, key=repr))
        elif isinstance(value, FunctionType):
            self._function(value)
        elif isinstance(value, CodeType):
            self.add([value.co_code, value.co_consts, value.co_names, value.co_varnames])
        elif isinstance(value, MethodType):
            self.add([value.__func__, value.__self__])
        elif isinstance(value, partial):
            self.add([value.func, value.args, value.keywords])
        elif isinstance(value, (type, ModuleType, BuiltinFunctionType, np.ufunc)):
            self._text(f"{getattr(value, '__module__', '')}.{value.__name__}")
        elif hasattr(value, "__wrapped__"):  # by jax.jit, for instance
            self.add(value.__wrapped__)
        elif dataclasses.is_dataclass(value):  # their other attributes are caches
            self.add({field.name: getattr(value, field.name) for field in dataclasses.fields(value)})
            self._methods(type(value))
        elif hasattr(value, "__dict__"):
            self.add(vars(value))
            self._methods(type(value))
        else:
            self.total.update(self.unknown(value))

    def _text(self, text: str) -> None:
        content = text.encode("utf-8", "backslashreplace")
        self.total.update(b"%d:" % len(content) + content)  # lengths keep "ab", "c" apart from "a", "bc"

    def _array(self, array: np.ndarray) -> None:
        self._text(f"{array.dtype.str}{array.shape}")
        if array.dtype.hasobject:
            self.add(array.tolist())
        else:
            self.total.update(np.ascontiguousarray(array).tobytes())

    def _model(self, part: Any) -> None:
        """A model, or a part of it such as its options; where its files were is no content."""
        for name in dir(part):
            value = getattr(part, name)
            if name.startswith("_") or callable(value) or name in _PLACES or name.endswith("_pathadr"):
                continue
            self._text(name)
            if isinstance(value, (np.ndarray, bytes, str, int, float)):
                self.add(value)
            else:
                self._model(value)

    def _function(self, function: FunctionType) -> None:
        self._text(f"{function.__module__}.{function.__qualname__}")
        if function.__module__.partition(".")[0] == _PACKAGE or id(function) in self.functions:
            return
        self.functions.add(id(function))
        self.add([function.__defaults__, function.__kwdefaults__])
        self.add([cell.cell_contents for cell in function.__closure__ or ()])
        self.add(function.__code__)
        codes = [function.__code__]
        for code in codes:
            codes += [item for item in code.co_consts if isinstance(item, CodeType)]
            for name in code.co_names:
                if name in function.__globals__:
                    self.add([name, function.__globals__[name]])

    def _methods(self, kind: type) -> None:
        if kind.__module__.partition(".")[0] != _PACKAGE:
            written = [item for item in vars(kind).values() if isinstance(item, FunctionType)]
            for method in written:
                if method.__code__.co_filename != "<string>":  # of a dataclass, made from its fields
                    self.add(method)


def _is_model(value: Any) -> bool:
    mujoco = sys.modules.get("mujoco")
    return mujoco is not None and isinstance(value, mujoco.MjModel)
