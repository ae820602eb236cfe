"""PyTorch files such as PACE's chirp_data.pt, read without PyTorch and without running any code of the file.

A .pt file is a zip archive: data.pkl names the tensors, data/0, data/1, ... hold their bytes. The pickle is read by an
unpickler that knows dictionaries, numbers, texts, and tensors of plain numbers on the CPU; whatever else it names is
refused before it is called.

    time (K,), dof_pos (K, n), des_dof_pos (K, n), optionally dof_vel, joint_names
"""

import math
import pickle
import pickletools
import zipfile
from collections.abc import Mapping, Sequence
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data.files.table import LogTable, check_log_size, log_table
from btr_mjx.runs import MAX_TABLE_BYTES, MAX_TEXT_BYTES, check_regular

_STORAGES = {
    **{"DoubleStorage": "<f8", "FloatStorage": "<f4", "HalfStorage": "<f2", "LongStorage": "<i8"},
    **{"IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "<i1", "ByteStorage": "<u1", "BoolStorage": "?"},
}
"""Types of numpy by storages of torch."""
_OPERATIONS = """
    PROTO FRAME STOP MARK GLOBAL STACK_GLOBAL REDUCE BINPERSID PUT BINPUT LONG_BINPUT MEMOIZE BINGET LONG_BINGET
    NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 BINFLOAT BINUNICODE SHORT_BINUNICODE
    EMPTY_DICT SETITEM SETITEMS EMPTY_LIST APPEND APPENDS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3
"""
"""What torch.save writes for dictionaries, lists, numbers, texts and tensors, in protocols 2 to 5. Others are refused:
BUILD, for one, sets attributes of whatever was named before."""
_NAMES = ("joint_names", "joint_order", "dof_names", "names")


def read_torch(path: Path) -> list[LogTable]:
    """Read the tensors of a .pt file as one table."""
    check_regular(path, MAX_TABLE_BYTES)
    try:
        with zipfile.ZipFile(path) as archive:
            check_log_size(sum(info.file_size for info in archive.infolist()), path)
            if any(info.compress_type != zipfile.ZIP_STORED for info in archive.infolist()):
                raise DamagedFile(f"{path}: its parts are compressed, which torch.save never does")
            content = _Tensors(archive).load()
    except InputError:
        raise
    except _Refused as refused:
        raise InputError(f"{path}: holds {refused}; save a dictionary of tensors on the CPU") from None
    except Exception as error:  # zipfile and pickle raise many types of errors for damaged bytes
        raise DamagedFile(f"{path}: not a readable .pt file ({type(error).__name__}: {error})") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: holds a {type(content).__name__}; expected a dictionary with time, dof_pos, ...")
    arrays = {str(k): v for k, v in content.items() if isinstance(v, np.ndarray) and v.ndim in (1, 2) and len(v)}
    if "time" not in arrays:
        raise InputError(f"{path}: holds no tensor 'time'; it holds {', '.join(map(repr, content)) or 'nothing'}")
    said: Sequence[Any] = next((content[key] for key in _NAMES if isinstance(content.get(key), list | tuple)), [])
    same = {k: v for k, v in arrays.items() if len(v) == len(arrays["time"])}
    groups = {k: list(map(str, said)) for k, v in same.items() if said and v.ndim == 2 and v.shape[1] == len(said)}
    return [log_table(path, path.stem, same, groups)]


class _Refused(Exception):
    """An object that is no plain data."""


class _Tensors(pickle.Unpickler):
    """An unpickler to which nothing is known but tensors: `find_class` never imports."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        main = next(name for name in archive.namelist() if name == "data.pkl" or name.endswith("/data.pkl"))
        program = archive.read(main)[:MAX_TEXT_BYTES]
        for operation, argument, _ in pickletools.genops(program):
            if operation.name not in _OPERATIONS.split():
                raise _Refused(f"the operation {operation.name}")
            if operation.name in ("LONG_BINPUT", "PUT") and int(argument or 0) > len(program):
                raise _Refused(f"a memo of {argument} objects")  # which would be allocated
        super().__init__(BytesIO(program))
        self._bytes, self._folder = cache(archive.read), main.removesuffix("data.pkl")

    def find_class(self, module: str, name: str) -> Any:
        if module == "torch" and name in _STORAGES:
            return np.dtype(_STORAGES[name])
        known = {("torch._utils", "_rebuild_tensor_v2"): _rebuild, ("collections", "OrderedDict"): dict}
        if (module, name) not in known:
            raise _Refused(f"the object {module}.{name}")
        return known[module, name]

    def persistent_load(self, pid: Any) -> np.ndarray:
        kind, storage, key, _, _ = pid
        if kind != "storage" or not isinstance(storage, np.dtype):
            raise _Refused(f"data of type {storage!r}")
        return np.frombuffer(self._bytes(f"{self._folder}data/{key}"), storage)


def _rebuild(storage: np.ndarray, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any) -> np.ndarray:
    """A tensor as an array; numpy refuses sizes that reach beyond the storage."""
    sound = all(type(n) is int and n >= 0 for n in (offset, *size, *stride))
    if not sound or math.prod(size) > len(storage):
        raise _Refused(f"a tensor of size {size} with {len(storage)} numbers")
    steps = [step * storage.itemsize for step in stride]
    return np.ndarray(size, storage.dtype, storage, offset * storage.itemsize, steps)
