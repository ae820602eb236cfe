"""Reading of TOML tables: unknown keys are noted, misspelt keys are errors."""

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import DamagedFile, InputError


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
      DamagedFile: it does not parse.
      OSError: it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DamagedFile(f"{path}: not valid TOML ({error})") from None


def check_keys(table: Any, known: Sequence[str], where: str, notes: list[str], strict: bool = True) -> None:
    """Check the keys of a table: a misspelt key is an error, any other unknown key is noted.

    Args:
      table: the value read from the file.
      known: the valid keys.
      where: file and table, for messages.
      notes: unknown keys are reported here.
      strict: False notes misspelt keys too instead of raising.

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
    """Whether a value of a TOML file is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


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
