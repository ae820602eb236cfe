"""Reads Parquet files and says which of them can be read: `python parquet_child.py`, see `parquet_check`.

Standard input holds a JSON list of paths. For each file one line of JSON is written once it was read: null, or what is
wrong with it. A file that ends the process has no line.
"""

import io
import json
import sys
from collections.abc import Callable

MAX_CELLS = 500_000_000
"""Most values of a table. A few bytes of a run-length code can stand for any number of rows."""

MEMORY_BYTES = 24 << 30
"""Address space of this process, so that a damaged length costs this process and not the machine."""


def limit_memory(limit: int) -> None:
    """Limit the address space of this process, where the operating system can."""
    try:
        import resource
    except ImportError:  # Windows
        return
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (limit if hard < 0 else min(limit, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def problem_of(read: Callable[[], None]) -> str | None:
    """What reading raised, in one line; panics of polars do not derive from Exception."""
    try:
        read()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return None


def read_parquet(path: str) -> None:
    """Read a file completely.

    Raises:
      ValueError: it declares too many values.
      BaseException: whatever polars raises for it.
    """
    import polars as pl

    with open(path, "rb") as file:
        data = file.read()
    declared = pl.scan_parquet(io.BytesIO(data))
    columns = len(declared.collect_schema())
    rows = declared.select(pl.len()).collect().item()
    if rows * max(columns, 1) > MAX_CELLS:
        raise ValueError(f"it declares {rows} rows of {columns} columns, at most {MAX_CELLS} values are read")
    frame = pl.read_parquet(io.BytesIO(data))
    frame.estimated_size()
    for series in frame:
        series.to_list() if series.dtype.is_nested() else series.to_physical().is_null().sum()


if __name__ == "__main__":
    limit_memory(MEMORY_BYTES)
    for one in json.load(sys.stdin):
        print(json.dumps(problem_of(lambda: read_parquet(one))), flush=True)  # noqa: B023
