"""Reading of TOML tables: unknown keys are noted, misspelt keys are errors."""

import difflib
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs.bounded_files import check_plain, read_text


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
      DamagedFile: it does not parse, or holds what `check_plain` refuses.
      InputError: it is no regular file, or too large.
      OSError: it cannot be read.
    """
    text = read_text(path)
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of integers with thousands of digits, and of deep nesting
        raise DamagedFile(f"{path}: not valid TOML ({error})") from None
    check_plain(table, str(path))
    return table


def check_keys(table: Any, known: Sequence[str], where: str, notes: list[str], strict: bool = True) -> None:
    """Check the keys of a table: a misspelt key is an error if strict, any other unknown key is added to the notes.

    Raises:
      InputError: a misspelt key, or the value is not a table.
    """
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: expected a table, got {table!r}")
    for key in table:
        if key in known:
            continue
        near = difflib.get_close_matches(key, known, 1, 0.75)
        if near and strict:
            raise InputError(f"{where}: unknown key {key!r}; did you mean {near[0]!r}?")
        meant = f"; did you mean {near[0]!r}?" if near else ""
        notes.append(f"{where}: unknown key {key!r} was ignored{meant}")


def is_number(value: Any) -> bool:
    """Whether a value of a TOML or JSON file is a number that a float can hold, and finite."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond the largest float
        return False


def toml_section(table: Mapping[str, Any], name: str, path: Path) -> Mapping[str, Any]:
    """The table [name].

    Raises:
      InputError: it is absent.
    """
    if not isinstance(table.get(name), Mapping):
        raise InputError(f"{path}: there is no [{name}] table; add one")
    return table[name]


def toml_rows(table: Mapping[str, Any], name: str, path: Path) -> list[Mapping[str, Any]]:
    """The rows [[name]]; empty if absent.

    Raises:
      InputError: the value is not an array of tables.
    """
    rows = table.get(name, [])
    if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
        raise InputError(f"{path}: write [[{name}]] with double brackets, once for each row")
    return rows


def file_name(table: Mapping[str, Any], key: str, where: str) -> str:
    """A required file name in a table.

    Raises:
      InputError: the key is absent or not a text.
    """
    value = table.get(key)
    if not isinstance(value, str) or not value:
        raise InputError(f"{where}: {key} = {value!r}: expected a file name")
    return value


def file_inside(table: Mapping[str, Any], key: str, folder: Path, where: str) -> Path:
    """A required file of a table, inside the folder of the file that names it.

    The name is compared as it is written: links inside the folder may point elsewhere.

    Raises:
      InputError: the key is absent or not a text, or the name leads out of the folder.
    """
    name = file_name(table, key, where)
    inside = "\0" not in name and not Path(name).is_absolute()
    if not inside or os.path.normpath(name).split(os.sep)[0] in (os.pardir, os.curdir):
        raise InputError(f"{where}: {key} = {name!r}: expected a file inside {folder}; copy it there")
    return folder / name
