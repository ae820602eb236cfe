"""Atomic writing and checked reading of files: JSON, arrays, tables and figures.

Every write is atomic, see `btr_mjx.runs.atomic`; every read compares with the SHA256SUMS of the folder, if it has one.

Formats:

- JSON is strict. A float that is not finite becomes one of the strings "NaN", "Infinity", "-Infinity", which
  `float()` reads back; null means no value. Tuples become lists, paths strings, dataclasses objects, numpy scalars and
  arrays numbers and lists.
- Arrays are `.npz` without pickle. The zip comment holds the SHA-256 of every byte before it, so that damage is
  detected; `numpy.load` reads it like any other `.npz`.
- Tables are CSV, or Parquet where a user asks for it, chosen by the suffix of the file name.
"""

import dataclasses
import hashlib
import json
import math
import os
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path, PurePath
from typing import Any, BinaryIO

import numpy as np
import polars as pl

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs.atomic import atomic_write
from btr_mjx.runs.bounded_files import MAX_TABLE_BYTES, check_regular, parse_json, read_limited
from btr_mjx.runs.checksums import check_listed

DIGEST_PREFIX = b"sha256:"
"""Start of the zip comment, before the digest."""

DIGEST_LENGTH = 64
"""Hexadecimal digits of a SHA-256 digest."""

MAX_EXPANSION = 200
"""Largest ratio of the arrays' size to that of their file, for arrays above `EXPANSION_FREE`. Constant columns beside
measured ones stay far below it; a few kilobytes of zeros that unpack to gigabytes do not."""

EXPANSION_FREE = 256 << 20
"""Size of arrays that may always be unpacked [bytes]."""

MAX_CELLS = 500_000_000
"""Most values of a Parquet table. A few bytes of a run-length code can stand for any number of rows."""


def to_plain(value: Any, *, strict: bool = True) -> Any:
    """Reduce a value to JSON types: None, bool, int, float, str, list and dict with str keys.

    Dataclasses (their init fields), paths, tuples, numpy scalars and arrays are reduced; if strict, floats that are not
    finite become strings.

    Raises:
      TypeError: a value or a key of any other type; the message names its place.
    """

    def reduce(value: Any, where: str) -> Any:
        if isinstance(value, np.generic | np.ndarray) and value.dtype.kind in "biufU":
            value = value.tolist()
        if value is None or isinstance(value, bool | int | str):
            return value
        if isinstance(value, float):
            if math.isfinite(value) or not strict:
                return value
            return "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
        if isinstance(value, PurePath):
            return value.as_posix()
        if isinstance(value, list | tuple):
            return [reduce(item, f"{where}[{i}]") for i, item in enumerate(value)]
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if field.init}
        if isinstance(value, Mapping):
            for key in value:
                if not isinstance(key, str):
                    raise TypeError(f"{where}: JSON keys are strings, got {key!r}")
            return {str(key): reduce(item, f"{where}.{key}") for key, item in value.items()}
        raise TypeError(f"{where}: cannot be written as JSON: {type(value).__name__}")

    return reduce(value, "value")


def write_json(path: str | Path, value: Any) -> None:
    """Write strict, indented JSON; see the module's notes and `to_plain` for what is allowed.

    Raises:
      TypeError: the value holds something that JSON cannot express.
      OSError: the file cannot be written.
    """
    text = json.dumps(to_plain(value), indent=2, allow_nan=False) + "\n"
    with atomic_write(path) as file:
        file.write(text.encode("utf-8"))


def read_json(path: str | Path) -> Any:
    """Read strict JSON. Numbers that are not finite are returned as the strings that were written.

    Raises:
      DamagedFile: not strict JSON (NaN tokens are refused too), names line and column; or not the file that its
        folder's SHA256SUMS lists.
      OSError: the file cannot be read.
    """
    data = read_limited(path)
    check_listed(path, data)
    return parse_json(data, str(path))


def _as_saved(name: str, value: Any) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.hasobject:
        raise TypeError(f"array {name!r}: object arrays cannot be saved without pickle; got dtype {array.dtype}")
    if array.dtype.kind == "V" and array.dtype.names is None:
        raise TypeError(f"array {name!r}: .npz does not keep dtype {array.dtype}; convert it first, e.g. to float32")
    return array


def write_arrays(path: str | Path, arrays: Mapping[str, Any], *, compress: bool = False) -> None:
    """Write named arrays as `.npz` with a SHA-256 digest of the file inside it.

    `read_arrays` restores every dtype bit for bit, NaN payloads included. Equal arrays give equal files.

    Raises:
      TypeError: an array of Python objects, or of a dtype that `.npz` does not keep (bfloat16).
      OSError: the file cannot be written.
    """
    saved = {name: _as_saved(name, array) for name, array in arrays.items()}
    with atomic_write(path) as file:
        with zipfile.ZipFile(file, "w") as archive:
            for name, array in saved.items():
                entry = zipfile.ZipInfo(f"{name}.npy")  # its date is a constant: equal arrays, equal bytes
                entry.compress_type = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
                with archive.open(entry, "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)
            archive.comment = DIGEST_PREFIX + b"0" * DIGEST_LENGTH
        digest = _digest(file)
        file.seek(-DIGEST_LENGTH, os.SEEK_END)
        file.write(digest)


def _digest(file: BinaryIO) -> bytes:
    """SHA-256, in hex, of all bytes except the last 64, where the digest itself is stored."""
    remaining = file.seek(0, os.SEEK_END) - DIGEST_LENGTH
    file.seek(0)
    total = hashlib.sha256()
    while remaining > 0:
        block = file.read(min(remaining, 1 << 20))
        if not block:
            break
        total.update(block)
        remaining -= len(block)
    return total.hexdigest().encode("ascii")


def read_arrays(path: str | Path, *, require_digest: bool = False) -> dict[str, np.ndarray]:
    """Read a `.npz` file and verify the digest that `write_arrays` stored.

    Args:
      path: the file.
      require_digest: also refuse files without a digest (those that another program wrote).

    Raises:
      DamagedFile: cut short, altered, not a `.npz` file or holding something else than arrays of numbers or text.
      InputError: the arrays are too large.
      OSError: the file cannot be read.
    """
    size = check_regular(Path(path), MAX_TABLE_BYTES)
    with Path(path).open("rb") as file:
        file.seek(-min(size, len(DIGEST_PREFIX) + DIGEST_LENGTH), os.SEEK_END)
        tail = file.read()
        if tail.startswith(DIGEST_PREFIX):
            if _digest(file) != tail[-DIGEST_LENGTH:]:
                raise DamagedFile(f"{path}: the checksum does not match, the file was altered")
        elif require_digest:
            raise DamagedFile(f"{path}: no checksum at the end, the file was cut short or is of another origin")
        try:
            with zipfile.ZipFile(file) as archive:
                unpacked = sum(member.file_size for member in archive.infolist())
                if unpacked <= min(MAX_TABLE_BYTES, max(EXPANSION_FREE, MAX_EXPANSION * size)):
                    return _members(file)
        except Exception as error:  # zipfile and numpy raise many types of errors for damaged bytes
            raise DamagedFile(f"{path}: not a readable .npz file ({error})") from error
    raise InputError(
        f"{path}: {size / 2**20:.3g} MiB unpack to {unpacked / 2**20:.6g} MiB; expected at most "
        f"{MAX_EXPANSION} times the file's size and {MAX_TABLE_BYTES / 2**20:.6g} MiB"
    )


def _members(file: BinaryIO) -> dict[str, np.ndarray]:
    file.seek(0)
    with warnings.catch_warnings(), np.load(file, allow_pickle=False) as saved:
        warnings.simplefilter("ignore")  # of headers that Python 2 wrote
        arrays = {name: saved[name] for name in saved.files}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):  # numpy returns the bytes of other members
            raise ValueError(f"its member {name!r} is no array")
    return arrays


def _suffix(path: str | Path) -> str:
    suffix = Path(path).suffix
    if suffix not in (".parquet", ".csv"):
        raise InputError(f"{path}: a table's name ends in .parquet or .csv, got {suffix or 'no suffix'!r}")
    return suffix


def write_table(path: str | Path, table: pl.DataFrame | Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> None:
    """Write a table as `.parquet` or `.csv`.

    In a CSV file an absent value is an empty field and a NaN is "NaN"; floats keep all their digits.

    Raises:
      InputError: another suffix.
      OSError: the file cannot be written.
    """
    suffix = _suffix(path)
    frame = table if isinstance(table, pl.DataFrame) else pl.DataFrame(table, infer_schema_length=None)
    # Complete before it is written: polars does not report a full disk as an OSError.
    content = BytesIO()
    frame.write_parquet(content) if suffix == ".parquet" else frame.write_csv(content)
    with atomic_write(path) as file:
        file.write(content.getvalue())


def read_table(path: str | Path) -> pl.DataFrame:
    """Read a `.parquet` or `.csv` table.

    Raises:
      InputError: another suffix, or too many values.
      DamagedFile: the content does not parse, or is not what the folder's SHA256SUMS lists.
      OSError: the file cannot be read.
    """
    suffix = _suffix(path)
    content = read_limited(path, MAX_TABLE_BYTES)
    check_listed(path, content)
    try:
        if suffix == ".csv":
            return pl.read_csv(content, infer_schema_length=None)
        declared = pl.scan_parquet(BytesIO(content))
        cells = declared.select(pl.len()).collect().item() * len(declared.collect_schema())
        if cells <= MAX_CELLS:
            return pl.read_parquet(BytesIO(content))
    # polars has no common base class for what its readers raise.
    except (Exception, pl.exceptions.PanicException) as error:
        raise DamagedFile(f"{path}: not a readable {suffix[1:]} table ({error})") from error
    raise InputError(f"{path}: it declares {cells} values, at most {MAX_CELLS} are read; divide it into several files")


def write_figure(path: str | Path, figure: Any, *, dpi: int = 150, **options: Any) -> None:
    """Save a matplotlib figure; the file name's suffix decides the format (.png, .svg, .pdf).

    Raises:
      OSError: the file cannot be written.
    """
    image = BytesIO()  # matplotlib backends may close the file that they write to
    figure.savefig(image, format=Path(path).suffix[1:] or "png", dpi=dpi, **options)
    with atomic_write(path) as file:
        file.write(image.getvalue())
