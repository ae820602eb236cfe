"""Reading of files that others made, with bounds: only regular files, and not more than a limit.

A device such as /dev/zero never ends, a pipe may never begin, and a file of unexpected size costs the machine's memory.
"""

import json
import math
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from btr_mjx.errors import DamagedFile, InputError

MAX_TEXT_BYTES = 64 << 20
"""Largest text file that is read (TOML, JSON, MJCF, templates) [bytes]."""

MAX_TABLE_BYTES = 16 << 30
"""Largest file of recordings that is read [bytes]."""

MAX_NESTING = 64
"""Deepest nesting of lists and tables in a TOML or JSON file."""


def check_regular(path: Path, limit: int) -> int:
    """Check that a path is a regular file of bounded size, before it is opened.

    Returns:
      Its size [bytes].

    Raises:
      InputError: a device, a pipe or a folder, or a file above the limit.
      OSError: it does not exist or cannot be examined.
    """
    try:
        found = path.stat()
    except ValueError as error:  # a null character in the name
        raise InputError(f"{str(path)!r} is not a file name ({error})") from None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(f"{path}: is a folder; expected a file")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: is a device or a pipe; expected a regular file")
    if found.st_size > limit:
        raise InputError(f"{path}: has {found.st_size / 2**20:.4g} MiB, at most {limit / 2**20:.4g} MiB are read")
    return found.st_size


def read_limited(path: str | Path, limit: int = MAX_TEXT_BYTES) -> bytes:
    """Content of a regular file.

    Raises:
      InputError: see `check_regular`.
      OSError: the file cannot be read.
    """
    path = Path(path)
    size = check_regular(path, limit)
    with path.open("rb") as file:
        data = file.read(size + 1)
    if len(data) > size:  # it grew since
        raise InputError(f"{path}: it changes while it is read; wait until it is complete")
    return data


def read_text(path: str | Path, limit: int = MAX_TEXT_BYTES) -> str:
    """Text of a UTF-8 file, with or without a byte order mark.

    Raises:
      DamagedFile: it is not UTF-8.
      InputError: see `check_regular`.
      OSError: the file cannot be read.
    """
    data = read_limited(path, limit)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise DamagedFile(
            f"{path}: line {line} holds the byte 0x{data[error.start]:02x}, which is not UTF-8; save the file as UTF-8"
        ) from None
    return text.replace("\r\n", "\n")


def parse_json(data: bytes, where: str) -> Any:
    """Value of strict JSON in UTF-8; `where` names it in messages.

    Raises:
      DamagedFile: not strict JSON (NaN tokens are refused too), or what `check_plain` refuses.
    """

    def refuse(token: str) -> None:
        raise ValueError(f"{token} is not JSON")

    try:
        value = json.loads(data.decode("utf-8"), parse_constant=refuse)
    except (ValueError, RecursionError) as error:  # also of integers with thousands of digits, and of deep nesting
        raise DamagedFile(f"{where}: not valid JSON ({error})") from None
    check_plain(value, where)
    return value


def check_plain(value: Any, where: str, depth: int = 0) -> None:
    """Check values (tables, lists and scalars) that came out of a TOML or JSON file.

    Raises:
      DamagedFile: an integer that no float can hold, or nesting deeper than `MAX_NESTING`. Both parse, and fail where
        they are converted or shown.
    """
    if depth > MAX_NESTING:
        raise DamagedFile(f"{where}: values are nested more than {MAX_NESTING} deep")
    if type(value) is int and value.bit_length() >= 1024:
        digits = math.ceil(value.bit_length() * math.log10(2))
        raise DamagedFile(f"{where}: it holds an integer of about {digits} digits, more than a float can hold")
    for item in value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ():
        check_plain(item, where, depth + 1)
