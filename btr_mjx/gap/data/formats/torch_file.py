"""PyTorch files such as PACE's chirp_data.pt, read without PyTorch and without running any code of the file.

A .pt file is a zip archive: data.pkl names the tensors, data/0, data/1, ... hold their bytes. The pickle is read by an
unpickler that knows dictionaries, numbers, texts, and tensors of plain numbers on the CPU; whatever else it names is
refused before it is called.

    time (K,), dof_pos (K, n), des_dof_pos (K, n), optionally dof_vel, joint_names
"""

import pickle
import pickletools
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data.tables import LogTable, check_log_size, log_table
from btr_mjx.runs import MAX_TABLE_BYTES, MAX_TEXT_BYTES, check_regular

_STORAGES: Mapping[str, str] = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "<i1",
    "ByteStorage": "<u1",
    "BoolStorage": "?",
}
_OPERATIONS = """
    PROTO FRAME STOP MARK GLOBAL STACK_GLOBAL REDUCE BINPERSID PUT BINPUT LONG_BINPUT MEMOIZE BINGET LONG_BINGET
    NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 BINFLOAT BINUNICODE SHORT_BINUNICODE
    EMPTY_DICT SETITEM SETITEMS EMPTY_LIST APPEND APPENDS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3
"""
"""What torch.save writes for dictionaries, lists, numbers, texts and tensors, in protocols 2 to 5."""
_NAMES = ("joint_names", "joint_order", "dof_names", "names")


def read_torch(path: Path) -> list[LogTable]:
    """Read the tensors of a .pt file as one table.

    Raises:
      InputError: objects other than tensors, no time, or sizes beyond bounds.
      DamagedFile: not a file of torch.save, or damaged.
      OSError: the file cannot be read.
    """
    check_regular(path, MAX_TABLE_BYTES)
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = {info.filename: info.file_size for info in archive.infolist()}
            check_log_size(sum(sizes.values()), path)
            main = next((name for name in sizes if name == "data.pkl" or name.endswith("/data.pkl")), None)
            if main is None or sizes[main] > MAX_TEXT_BYTES:
                raise DamagedFile(f"{path}: not a file of torch.save (it holds no data.pkl)")
            if any(info.compress_type != zipfile.ZIP_STORED for info in archive.infolist()):
                raise DamagedFile(f"{path}: its parts are compressed, which torch.save never does")
            program = archive.read(main)
            _check_program(program)
            content = _Tensors(program, archive, main.removesuffix("data.pkl")).load()
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
    said = next((content[key] for key in _NAMES if isinstance(content.get(key), list | tuple)), None)
    names = [str(name) for name in said] if said else None
    same = {k: v for k, v in arrays.items() if len(v) == len(arrays["time"])}
    groups = {k: names for k, v in same.items() if names and v.ndim == 2 and v.shape[1] == len(names)}
    return [log_table(path, path.stem, same, groups)]


def _check_program(program: bytes) -> None:
    """Refuse operations that plain data do not need, and memory beyond the size of the program.

    BUILD, for one, sets attributes of whatever was named before: also of a function of this module.
    """
    for operation, argument, _ in pickletools.genops(program):
        if operation.name not in _OPERATIONS.split():
            raise _Refused(f"the operation {operation.name}")
        if operation.name in ("LONG_BINPUT", "PUT") and int(argument or 0) > len(program):
            raise _Refused(f"a memo of {argument} objects")


class _Refused(Exception):
    """An object that is no plain data."""


class _Storage(str):
    """The numpy type of a storage class."""


class _Tensors(pickle.Unpickler):
    """An unpickler to which nothing is known but tensors: `find_class` never imports."""

    def __init__(self, data: bytes, archive: zipfile.ZipFile, folder: str) -> None:
        super().__init__(BytesIO(data))
        self._archive, self._folder = archive, folder
        self._storages: dict[str, np.ndarray] = {}

    def find_class(self, module: str, name: str) -> Any:
        if module == "torch" and name in _STORAGES:
            return _Storage(_STORAGES[name])
        known: Mapping[tuple[str, str], Callable[..., Any]] = {
            ("torch._utils", "_rebuild_tensor_v2"): _rebuild,
            ("collections", "OrderedDict"): OrderedDict,
        }
        if (module, name) not in known:
            raise _Refused(f"the object {module}.{name}")
        return known[module, name]

    def persistent_load(self, pid: Any) -> np.ndarray:
        kind, storage, key, _, _ = pid
        if kind != "storage" or not isinstance(storage, _Storage):
            raise _Refused(f"data of type {storage!r}")
        name = f"{self._folder}data/{key}"
        if name not in self._storages:
            self._storages[name] = np.frombuffer(self._archive.read(name), np.dtype(str(storage)))
        return self._storages[name]


def _rebuild(storage: np.ndarray, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any) -> np.ndarray:
    """A tensor as an array; raises where its sizes reach beyond the storage."""
    sound = all(type(n) is int and n >= 0 for n in (offset, *size, *stride)) and len(size) == len(stride) <= 8
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True)) if sound else -1
    if not sound or (0 not in size and last >= len(storage)):
        raise _Refused(f"a tensor of size {size} with {len(storage)} numbers")
    if 0 in size:
        return np.zeros(size)
    if int(np.prod([float(n) for n in size])) > len(storage):
        raise _Refused(f"a tensor of size {size} that repeats its {len(storage)} numbers")
    steps = [step * storage.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps, writeable=False)
