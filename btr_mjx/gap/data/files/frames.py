"""Data frames as tables, and Parquet files, which hold one."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import polars as pl

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data.files.table import LogTable, log_table
from btr_mjx.runs import read_table

MISSING_TEXTS = ("", "-", "--", "na", "n/a", "nan", "null", "none")
"""Texts, in lower case, that stand for a missing value."""
BLOCK_NUMBERS = 1 << 21
"""Numbers of a Parquet file that are read at once."""
READ_ERRORS = Exception, pl.exceptions.PanicException
"""What polars' readers raise: they have no common base class."""


def frame_table(path: Path, frame: pl.DataFrame, units: Mapping[str, str] | None = None, first: int = 0) -> LogTable:
    """The table of a frame of numbers and of lists of numbers; `first` rows of the file are before it."""
    arrays: dict[str, np.ndarray] = {}
    text: dict[str, str] = {}
    for series in frame:
        name = series.name.strip()
        try:
            arrays[name] = _values(path, series, first)
        except InputError as error:
            arrays[name], text[name] = np.full(len(frame), np.nan), str(error)
    return log_table(path, path.stem, arrays, None, units, text)


def _values(path: Path, series: pl.Series, first: int) -> np.ndarray:
    """Values (K,) of a column or (K, n) of lists, NaN where there are none."""
    kind = series.dtype
    if kind.is_numeric() or kind in (pl.Boolean, pl.Null):
        return series.cast(pl.Float64).fill_null(np.nan).to_numpy()
    if isinstance(kind, pl.List | pl.Array) and isinstance(kind.inner, pl.DataType) and kind.inner.is_numeric():
        if series.null_count() or (isinstance(kind, pl.List) and series.list.len().n_unique() > 1):
            raise InputError(f"{path}: column {series.name!r} holds lists of different lengths; expected equal ones")
        return np.array(series.to_list(), float)
    if kind != pl.String:
        raise InputError(f"{path}: column {series.name!r} holds {kind}, expected numbers")
    own = series.str.strip_chars().str.to_lowercase().replace(["true", "false"], ["1", "0"])
    values = own.cast(pl.Float64, strict=False)
    bad = values.is_null() & own.is_not_null() & ~own.is_in(MISSING_TEXTS)
    if bad.any():
        row = int(bad.arg_true()[0])
        raise InputError(
            f"{path}: column {series.name!r} holds {series[row]!r} in row {first + row + 1} of the data; expected "
            "a number (units belong into the documentation, not into a row)"
        )
    return values.fill_null(np.nan).to_numpy()


def read_parquet_table(path: Path) -> list[LogTable]:
    """Read a Parquet file."""
    return [frame_table(path, read_table(path))]


def count_parquet_rows(path: Path) -> int:
    """Number of rows."""
    return int(pl.scan_parquet(path).select(pl.len()).collect().item())


def parquet_blocks(path: Path, advance: Callable[[int], None]) -> Iterator[LogTable]:
    """Successive rows of a Parquet file; `advance` is called with numbers of bytes."""
    try:
        rows, names = count_parquet_rows(path), list(pl.read_parquet_schema(path))
        size, share = max(1, BLOCK_NUMBERS // max(len(names), 1)), path.stat().st_size / max(rows, 1)
        for first in range(0, rows, size):
            frame = pl.scan_parquet(path).slice(first, size).collect()
            advance(int(share * len(frame)))
            yield frame_table(path, frame, None, first)
    except InputError:
        raise
    except READ_ERRORS as error:
        raise DamagedFile(f"{path}: not a readable parquet table ({error})") from error
