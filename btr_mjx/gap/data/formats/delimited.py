"""Text tables in any dialect: which separator, decimal sign, comments, names and units a file has, and its numbers.

The rows of numbers are found first: the separator and the decimal sign are those with which the most fields are
numbers, and the most lines in a row have equally many. The line above them holds the names, with a row of units between
if there is one; a comment sign in front of the names is taken off. Everything before is a comment.
"""

import csv
import re
from collections import Counter
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import polars as pl

from btr_mjx.errors import DamagedFile, InputError, one_line
from btr_mjx.gap.data.names.units import is_unit_text, known_unit
from btr_mjx.gap.data.plausible import MAX_HEADER_BYTES, check_column_count
from btr_mjx.runs import MAX_TABLE_BYTES, check_listed, read_limited

_DIALECTS = ((",", False), (";", False), (";", True), ("\t", False), ("\t", True), (" ", False), (" ", True))
"""Separators and whether the decimal sign is a comma, in the order of preference."""
_COMMENTS = ("#", "%", "//")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "+inf", "true", "false")
"""Texts, in lower case, that may stand where a number belongs."""
_SAMPLE_LINES = 200
"""Lines at the beginning that decide about the dialect."""
_READ_ERRORS = Exception, pl.exceptions.PanicException


@dataclass(frozen=True)
class Dialect:
    """How a file writes its table.

    Attributes:
      separator: between fields; " " stands for any number of spaces and tabs.
      decimal_comma: whether numbers have a comma.
      names: of the columns, "" where there is none; "1", "2", ... in a file without names.
      units: of the columns, None where none is stated.
      start: byte of the first row of numbers.
      comment: sign that begins a comment line, or None.
      first_line: number of lines before the numbers.
    """

    separator: str
    decimal_comma: bool
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    start: int
    comment: str | None
    first_line: int

    @property
    def stated_units(self) -> dict[str, str]:
        """Units by name, of the columns that have one in the row of units."""
        return {name: unit for name, unit in zip(self.names, self.units, strict=True) if name and unit}


def read_dialect(path: Path) -> Dialect:
    """Find the dialect of a text table from its first lines.

    Raises:
      DamagedFile: the file is empty, or no table; the message shows its first line.
      InputError: too many columns, or a name that occurs twice.
      OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(MAX_HEADER_BYTES)
    if not head.strip():
        raise DamagedFile(f"{path}: the file is empty")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise DamagedFile(f"{path}: it is UTF-16; save the file as UTF-8")
    if b"\n" not in head and len(head) == MAX_HEADER_BYTES:
        raise DamagedFile(f"{path}: the first line has no end within {MAX_HEADER_BYTES} bytes; expected column names")
    lines = head.splitlines(keepends=True) if b"\n" in head else [head]
    if len(head) == MAX_HEADER_BYTES and len(lines) > 1:
        lines.pop()  # cut
    texts = [_decoded(line).strip("\r\n") for line in lines]
    texts[0] = texts[0].removeprefix("\ufeff")
    check_column_count(max(text.count(",") for text in texts[:3]) + 1, path)
    separator, decimal_comma, first = _numbers_begin(path, texts)
    names, units = _names_above(texts[:first], separator, len(split_line(texts[first], separator)))
    comment = next((sign for sign in _COMMENTS if any(text.lstrip().startswith(sign) for text in texts)), None)
    for name, count in Counter(name for name in names if name).most_common(1):
        if count > 1:
            raise InputError(f"{path}: column {name!r} occurs {count} times; keep one of them")
    start = sum(map(len, lines[:first]))
    return Dialect(separator, decimal_comma, tuple(names), tuple(units), start, comment, first)


def _decoded(line: bytes) -> str:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:  # programs on Windows write a degree sign in their own code page
        return line.decode("cp1252", "replace")


def split_line(line: str, separator: str) -> list[str]:
    """Fields of a line, without spaces and quotes around them."""
    if separator == " ":
        return line.split()
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:
        return []


def _numbers_in(fields: list[str], decimal_comma: bool) -> int:
    """Number of fields that are numbers; 0 if one has another decimal sign than the others should."""
    count = 0
    for field in fields:
        if decimal_comma and "." in field and _NUMBER.fullmatch(field):
            return 0
        count += _NUMBER.fullmatch(field.replace(",", ".", 1) if decimal_comma else field) is not None
    return count


def _numbers_begin(path: Path, texts: list[str]) -> tuple[str, bool, int]:
    """Separator, whether there are decimal commas, and the first line of numbers."""
    best: tuple[tuple[float, int, int], str, bool, int] | None = None
    lines = [(i, text) for i, text in enumerate(texts[:_SAMPLE_LINES]) if text.strip()]
    lines = [(i, text) for i, text in lines if not text.lstrip().startswith(_COMMENTS)]
    for separator, decimal_comma in _DIALECTS:
        rows = [(i, split_line(text, separator)) for i, text in lines]
        if decimal_comma and not any("," in field for _, fields in rows for field in fields):
            continue
        run, numbers, filled = 0, 0, 0
        runs: list[tuple[int, int, int, int, int]] = []  # rows, first line, width, numbers, fields with content
        width = 0
        for i, fields in rows:
            found = _numbers_in(fields, decimal_comma)
            content = sum(field.lower() not in _MISSING for field in fields)
            if len(fields) < 2 or not found or 2 * found < content:
                width = 0
                continue
            if len(fields) != width:
                run, numbers, filled, width = 0, 0, 0, len(fields)
                runs.append((0, i, width, 0, 0))
            run, numbers, filled = run + 1, numbers + found, filled + content
            runs[-1] = run, runs[-1][1], width, numbers, filled
        if runs:
            count, first, width, numbers, filled = max(runs, key=lambda one: (one[0], -one[1]))
            score = numbers / filled, count, width
            if best is None or score > best[0]:
                best = score, separator, decimal_comma, first
    if best is None:
        shown = next((text for text in texts if text.strip()), "")[:80]
        if len(lines) == 1 and len(split_line(lines[0][1], ",")) > 1:
            raise InputError(f"{path}: it holds no rows below the names {shown!r}")
        raise DamagedFile(
            f"{path}: it holds no table: no line of two or more numbers separated by comma, semicolon, tab or spaces; "
            f"its first line is {shown!r}"
        )
    return best[1:]


def _names_above(above: list[str], separator: str, width: int) -> tuple[list[str], list[str | None]]:
    """Names and units of the columns, from the lines above the numbers."""
    units: list[str | None] = [None] * width
    for text in reversed([text for text in above if text.strip()][-4:]):
        line = _uncommented(text)
        fields = next((f for s in (separator, ",", ";", "\t", " ") if _fits(f := split_line(line, s), width)), None)
        if fields is None:
            break
        fields += [""] * (width - len(fields))
        if all(map(is_unit_text, fields)) and any(map(known_unit, fields)):
            units = [known_unit(field) for field in fields]
            continue
        return fields[:width], units
    return [str(i + 1) for i in range(width)], units


def _fits(fields: list[str], width: int) -> bool:
    """Whether a line of names belongs to rows of this width; a separator at the end of either makes one more field."""
    return len(fields) == width or len(fields) == width - 1 > 1 or (len(fields) == width + 1 and not fields[-1])


def _uncommented(text: str) -> str:
    text = text.strip()
    for sign in _COMMENTS:
        if text.startswith(sign):
            return text.lstrip(sign).strip()
    return text


def parse_rows(path: Path, dialect: Dialect, text: bytes) -> pl.DataFrame:
    """The columns of whole lines of numbers.

    Args:
      path: for messages.
      dialect: of the file.
      text: the lines.

    Returns:
      Columns with a name; of numbers, or of text where a field is none.

    Raises:
      DamagedFile: lines with more fields than there are columns, or text that does not parse.
    """
    if dialect.separator == " ":
        text = b"\n".join(b" ".join(line.split()) for line in text.splitlines() if line.strip())
    keys = [str(i) for i in range(len(dialect.names))]
    options = {
        "has_header": False,
        "separator": dialect.separator,
        "decimal_comma": dialect.decimal_comma,
        "comment_prefix": dialect.comment,
        "new_columns": keys,
    }
    try:
        try:
            frame = pl.read_csv(BytesIO(text), schema_overrides=[pl.Float64] * len(keys), **options)  # type: ignore[arg-type]
        except pl.exceptions.NoDataError:
            frame = pl.DataFrame(schema=dict.fromkeys(keys, pl.Float64))
        except pl.exceptions.PolarsError:  # text, booleans, spaces
            options["decimal_comma"] = False
            frame = pl.read_csv(BytesIO(text), infer_schema_length=0, **options)  # type: ignore[arg-type]
            texts = [_as_numbers(pl.col(key), dialect.decimal_comma) for key in frame.columns]
            frame = frame.with_columns(texts)
    except _READ_ERRORS as error:
        wrong = _first_of_other_width(dialect, text)
        raise DamagedFile(
            f"{path}: not a readable table of {len(keys)} columns ({wrong or one_line(error)})"  # type: ignore[arg-type]
        ) from None
    if frame.width != len(keys):
        raise DamagedFile(f"{path}: rows have {frame.width} fields, the names {len(keys)}; expected as many")
    named = {key: name for key, name in zip(keys, dialect.names, strict=True) if name}
    return frame.select(list(named)).rename(named)


def _first_of_other_width(dialect: Dialect, text: bytes) -> str:
    """The first line with more fields than there are columns, for messages."""
    for line in map(_decoded, text.splitlines()):
        if len(split_line(line, dialect.separator)) > len(dialect.names):
            return f"a line has {len(split_line(line, dialect.separator))} fields: {line[:60]!r}"
    return ""


def read_text_table(path: Path) -> tuple[pl.DataFrame, Dialect]:
    """Read a whole text table.

    Raises:
      InputError, DamagedFile, OSError: see `read_dialect` and `parse_rows`.
    """
    dialect = read_dialect(path)
    content = read_limited(path, MAX_TABLE_BYTES)
    check_listed(path, content)
    return parse_rows(path, dialect, content[dialect.start :]), dialect


def _as_numbers(column: pl.Expr, decimal_comma: bool) -> pl.Expr:
    """Text of numbers in the form that polars reads; missing values are null."""
    text = column.str.strip_chars()
    lower = text.str.to_lowercase()
    text = pl.when(lower.is_in(["true", "false"])).then((lower == "true").cast(pl.Int8).cast(pl.String)).otherwise(text)
    if decimal_comma:
        text = text.str.replace(",", ".", literal=True)
    return pl.when(lower.is_in(["", "na", "n/a", "null", "none", "-", "--"])).then(None).otherwise(text).name.keep()
