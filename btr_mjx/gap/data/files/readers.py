"""Which reader reads which file: the formats of the package, and those of installed packages.

A package adds a format in the entry point group `btr_mjx.readers`; each entry point names a `Reader`. It is asked for
files that no reader of this package takes.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data.files.arrays import count_npz_rows, read_npz
from btr_mjx.gap.data.files.frames import READ_ERRORS, count_parquet_rows, parquet_blocks, read_parquet_table
from btr_mjx.gap.data.files.hdf5 import count_hdf5_rows, read_hdf5
from btr_mjx.gap.data.files.ros_bag import count_messages, is_ros_folder, read_ros
from btr_mjx.gap.data.files.table import LogTable
from btr_mjx.gap.data.files.text import count_lines, holds_numbers, read_text_table, text_blocks
from btr_mjx.gap.data.files.torch_file import read_torch
from btr_mjx.runs import installed_objects

GROUP = "btr_mjx.readers"
"""Entry point group of readers of other packages."""


@dataclass(frozen=True)
class Reader:
    """How files of a format are read.

    Attributes:
      suffixes: of its files, in lower case and with the dot.
      read: tables of a file, under the file's own names; raises `InputError` for content that cannot be used and for a
        library that is not installed, `DamagedFile` for what does not parse, `OSError` for what cannot be read.
      is_folder: whether a folder is a recording of this format; None where recordings are files only.
      rows: number of rows of a file, or a few more, told without reading it; with it, a file of very many rows is used
        in stretches.
      blocks: successive rows of the one table of a long file, with the same columns in each; calls its second argument
        with the numbers of bytes that it has read. None where long files are read as a whole.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path], Sequence[LogTable]]
    is_folder: Callable[[Path], bool] | None = None
    rows: Callable[[Path], int] | None = None
    blocks: Callable[[Path, Callable[[int], None]], Iterator[LogTable]] | None = None


_ROS = Reader((".mcap", ".db3", ".bag"), read_ros, is_ros_folder, count_messages)
_TEXT = Reader((".csv", ".tsv", ".txt", ".dat", ".log"), read_text_table, None, count_lines, text_blocks)
READERS = (
    _TEXT,
    Reader((".parquet",), read_parquet_table, None, count_parquet_rows, parquet_blocks),
    Reader((".npz",), read_npz, None, count_npz_rows),
    Reader((".h5", ".hdf5", ".hdf"), read_hdf5, None, count_hdf5_rows),
    _ROS,
    Reader((".pt",), read_torch),
)
"""The formats of this package."""


def _readers() -> Iterator[Reader]:
    yield from READERS
    yield from installed_objects(GROUP, Reader).values()  # loaded only where they are needed


def log_suffixes() -> tuple[str, ...]:
    """Suffixes of the files that can be recordings."""
    return tuple(suffix for reader in _readers() for suffix in reader.suffixes)


def reader_of(path: Path) -> Reader | None:
    """The reader of a file or folder; None if it is no recording."""
    if path.is_dir():
        return next((one for one in _readers() if one.is_folder is not None and one.is_folder(path)), None)
    return next((one for one in _readers() if path.suffix.lower() in one.suffixes), None)


def is_log(path: Path) -> bool:
    """Whether a path has the form of a recording."""
    return path.exists() and reader_of(path) is not None


def is_prose(path: Path) -> bool:
    """Whether a file has the form of a text table, and something else than rows of numbers in it."""
    return reader_of(path) is _TEXT and path.stat().st_size > 0 and not holds_numbers(path)


def read_file(
    path: Path, topics: Mapping[str, str] | None = None, model: mujoco.MjModel | None = None
) -> Sequence[LogTable]:
    """Read the tables of a log, see `Reader.read`; of ROS recordings those of the `topics`, see `read_ros`."""
    reader = reader_of(path)
    if reader is None:
        raise InputError(
            f"{path}: a recording is a {', '.join(log_suffixes())} file, got {path.suffix or 'no suffix'!r}"
        )
    if path.is_file() and path.stat().st_size == 0 and reader is not _ROS:
        raise DamagedFile(f"{path}: the file is empty")
    return read_ros(path, topics or {}, model) if reader is _ROS else reader.read(path)


def count_rows(path: Path) -> int:
    """Number of rows of a recording, or a few more; 0 where that cannot be told."""
    reader = reader_of(path)
    try:
        return reader.rows(path) if reader is not None and reader.rows is not None else 0
    except READ_ERRORS:  # `read_file` says what is wrong with it
        return 0


def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """Read a table of measurements whose columns have MuJoCo's names, see `columns.model_columns`.

    Returns:
      Arrays by column name, (K,) float64 each, or (K, n) for the grouped columns of an NPZ file. Empty fields are NaN.

    Raises:
      InputError: see `read_file`; also several tables, or text instead of numbers.
      DamagedFile: the content does not parse.
      OSError: the file cannot be read.
    """
    tables = read_file(Path(path))
    if len(tables) != 1:
        raise InputError(f"{path}: holds {len(tables)} tables; expected one")
    for problem in tables[0].text.values():
        raise InputError(problem)
    return dict(tables[0].columns)
