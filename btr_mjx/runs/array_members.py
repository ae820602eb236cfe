"""Arrays of a `.npz` file, read with bounds: sizes are compared with what the file holds before memory is taken."""

import math
import os
import warnings
import zipfile
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs.bounded_files import MAX_TABLE_BYTES

MAX_MEMBERS = 10_000
"""Largest number of arrays in a file."""

MAX_EXPANSION = 200
"""Largest ratio of the arrays' size to the file's, for arrays above `EXPANSION_FREE`. Constant columns beside measured
ones stay far below it; a few kilobytes of zeros that unpack to gigabytes do not."""

EXPANSION_FREE = 256 << 20
"""Size that may always be unpacked [bytes]."""


def read_members(file: BinaryIO, path: Path) -> dict[str, np.ndarray]:
    """All arrays of an open `.npz` file.

    Args:
      file: at any place.
      path: for messages.

    Returns:
      Arrays by name.

    Raises:
      InputError: the arrays are too many or too large.
      DamagedFile: not a `.npz` file, damaged, or a member that is no array of numbers or text.
    """
    file.seek(0)
    if file.read(6) == b"\x93NUMPY":
        raise DamagedFile(f"{path}: not a readable .npz file (it holds a single .npy array)")
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            _check_sizes(members, file.seek(0, os.SEEK_END), path)
            arrays: dict[str, np.ndarray] = {}
            for member in members:
                name = member.filename.removesuffix(".npy")
                if name == member.filename or name in arrays:
                    problem = "there twice" if name in arrays else "no array"
                    raise ValueError(f"its member {member.filename!r} is {problem}")
                with archive.open(member) as content, warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    _check_header(content, member)
                with archive.open(member) as content, warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of headers that Python 2 wrote
                    arrays[name] = np.lib.format.read_array(content, allow_pickle=False)
            return arrays
    except InputError:
        raise
    except Exception as error:  # zipfile and numpy raise many types of errors for damaged bytes
        raise DamagedFile(f"{path}: not a readable .npz file ({error})") from error


def _check_sizes(members: list[zipfile.ZipInfo], packed: int, path: Path) -> None:
    unpacked = sum(member.file_size for member in members)
    if len(members) > MAX_MEMBERS:
        raise InputError(f"{path}: holds {len(members)} arrays, at most {MAX_MEMBERS} are read")
    if unpacked > MAX_TABLE_BYTES or (unpacked > EXPANSION_FREE and unpacked > MAX_EXPANSION * packed):
        raise InputError(
            f"{path}: {packed / 2**20:.3g} MiB unpack to {unpacked / 2**20:.6g} MiB; expected at most "
            f"{MAX_EXPANSION} times the file's size and {MAX_TABLE_BYTES / 2**20:.6g} MiB"
        )


def _check_header(content: IO[bytes], member: zipfile.ZipInfo) -> None:
    """Raise ValueError where a member is no array, or its header promises more than the member holds."""
    try:
        version = np.lib.format.read_magic(content)
    except ValueError:
        raise ValueError(f"its member {member.filename!r} is no array") from None
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(content)
    if dtype.hasobject:
        raise ValueError(f"its array {member.filename!r} holds Python objects; Object arrays are not read")
    if any(n < 0 for n in shape) or math.prod(shape) * max(dtype.itemsize, 1) > member.file_size:
        raise ValueError(f"its array {member.filename!r} of shape {shape} is cut short")
