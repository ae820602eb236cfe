"""Text tables in any dialect: which separator, decimal sign, comments, names and units a file has, and its numbers.

The rows of numbers are found first: the separator and the decimal sign are those with which the most fields are
numbers, and the most lines in a row have equally many. The line above them holds the names, with a row of units between
if there is one; a comment sign in front of the names is taken off. Everything before is a comment.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import polars as pl

from btr_mjx.errors import DamagedFile, InputError, one_line
from btr_mjx.gap.data.columns.units import is_unit_text, known_unit
from btr_mjx.gap.data.files.frames import READ_ERRORS, frame_table
from btr_mjx.gap.data.files.table import LogTable, check_column_count
from btr_mjx.runs import MAX_TABLE_BYTES, check_listed, read_limited

BLOCK_BYTES = 1 << 24
"""Bytes of a long file that are parsed at once."""
MAX_HEADER_BYTES = 1 << 20
"""Bytes at the beginning of a file from which its form is told; a line of names has fewer."""
_DIALECTS = ((",", False), (";", False), (";", True), ("\t", False), ("\t", True), (" ", False), (" ", True))
"""Separators and whether the decimal sign is a comma, in the order of preference."""
_COMMENTS = ("#", "%", "//")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "+inf", "true", "false")
"""Texts, in lower case, that may stand where a number belongs."""
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_SAMPLE_LINES = 200
"""Lines at the beginning that decide about the dialect."""


@dataclass(frozen=True)
class Dialect:
    """How a file writes its table.

    Attributes:
      separator: between fields; " " stands for any number of spaces and tabs.
      decimal_comma: whether numbers have a comma.
      names: of the columns, "" where there is none; "1", "2", ... in a file without names.
      units: by name, of the columns that have one in a row of units.
      start: byte of the first row of numbers.
      comment: sign that begins a comment line, or None.
    """

    separator: str
    decimal_comma: bool
    names: tuple[str, ...]
    units: Mapping[str, str]
    start: int
    comment: str | None


def read_dialect(path: Path) -> Dialect:
    """Find the dialect of a text table from its first lines."""
    with path.open("rb") as file:
        head = file.read(MAX_HEADER_BYTES)
    if not head.strip():
        raise DamagedFile(f"{path}: the file is empty")
    if head.startswith(_UTF_16):
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
    stated = {name: unit for name, unit in zip(names, units, strict=True) if name and unit}
    return Dialect(separator, decimal_comma, tuple(names), stated, start, comment)


def holds_numbers(path: Path) -> bool:
    """Whether a text file has a line that may be a row of a table: two or more numbers, and not many words.

    UTF-16 may hold one; `read_dialect` refuses it.
    """
    with path.open("rb") as file:
        head = file.read(MAX_HEADER_BYTES)
    if head.startswith(_UTF_16):
        return True
    texts = [_decoded(line) for line in head.splitlines()[:_SAMPLE_LINES]]
    lines = [(i, text) for i, text in enumerate(texts) if text.strip() and not text.lstrip().startswith(_COMMENTS)]
    return any(_longest_run(lines, separator, decimal_comma) for separator, decimal_comma in _DIALECTS)


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
    lines = [(i, text) for i, text in enumerate(texts[:_SAMPLE_LINES]) if text.strip()]
    lines = [(i, text) for i, text in lines if not text.lstrip().startswith(_COMMENTS)]
    found = []
    for separator, decimal_comma in _DIALECTS:
        run = _longest_run(lines, separator, decimal_comma)
        if run and (not decimal_comma or any("," in f for _, text in lines for f in split_line(text, separator))):
            numbers, content = (sum(map(itemgetter(k), run)) for k in (2, 3))
            found.append(((numbers / content, len(run), run[0][1]), separator, decimal_comma, run[0][0]))
    if found:
        return max(found, key=itemgetter(0))[1:]
    shown = next((text for text in texts if text.strip()), "")[:80]
    if len(lines) == 1 and len(split_line(lines[0][1], ",")) > 1:
        raise InputError(f"{path}: it holds no rows below the names {shown!r}")
    raise DamagedFile(
        f"{path}: it holds no table: no line of two or more numbers separated by comma, semicolon, tab or spaces; "
        f"its first line is {shown!r}"
    )


def _longest_run(
    lines: Sequence[tuple[int, str]], separator: str, decimal_comma: bool
) -> list[tuple[int, int, int, int]]:
    """Rows of numbers of equal width that follow each other: line, width, numbers and fields with content of each."""
    rows = []
    for i, text in lines:
        fields = split_line(text, separator)
        numbers = _numbers_in(fields, decimal_comma)
        content = sum(field.lower() not in _MISSING for field in fields)
        width = len(fields) if len(fields) > 1 and numbers and 2 * numbers >= content else 0
        rows.append((i, width, numbers, content))
    runs = (list(group) for width, group in groupby(rows, key=itemgetter(1)) if width)
    return max(runs, key=len, default=[])


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
    """The columns with a name of whole lines of numbers; of text where a field is none."""
    if dialect.separator == " ":
        text = b"\n".join(b" ".join(line.split()) for line in text.splitlines() if line.strip())
    keys = [str(i) for i in range(len(dialect.names))]
    options = {"has_header": False, "separator": dialect.separator, "comment_prefix": dialect.comment}
    options |= {"new_columns": keys, "decimal_comma": dialect.decimal_comma}
    try:
        try:
            frame = pl.read_csv(BytesIO(text), schema_overrides=[pl.Float64] * len(keys), **options)  # type: ignore[arg-type]
        except pl.exceptions.NoDataError:
            frame = pl.DataFrame(schema=dict.fromkeys(keys, pl.Float64))
        except pl.exceptions.PolarsError:  # text, booleans, spaces
            options["decimal_comma"] = False
            frame = pl.read_csv(BytesIO(text), infer_schema_length=0, **options)  # type: ignore[arg-type]
            if dialect.decimal_comma:
                frame = frame.with_columns(pl.all().str.replace(",", ".", literal=True))
    except READ_ERRORS as error:
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


def read_text_table(path: Path) -> list[LogTable]:
    """Read a whole text table."""
    dialect = read_dialect(path)
    content = read_limited(path, MAX_TABLE_BYTES)
    check_listed(path, content)
    return [frame_table(path, parse_rows(path, dialect, content[dialect.start :]), dialect.units)]


def count_lines(path: Path) -> int:
    """Number of lines: that of the rows, or a few more."""
    with path.open("rb") as file:
        return sum(block.count(b"\n") for block in iter(lambda: file.read(BLOCK_BYTES), b""))


def text_blocks(path: Path, advance: Callable[[int], None]) -> Iterator[LogTable]:
    """Successive rows of a text table; `advance` is called with numbers of bytes."""
    dialect, first = read_dialect(path), 0
    for lines in _whole_lines(path, dialect.start, advance):
        frame = parse_rows(path, dialect, lines)
        if len(frame):
            yield frame_table(path, frame, dialect.units, first)
            first += len(frame)


def _whole_lines(path: Path, start: int, advance: Callable[[int], None]) -> Iterator[bytes]:
    with path.open("rb") as file:
        file.seek(start)
        rest = b""
        while block := file.read(BLOCK_BYTES):
            advance(len(block))
            whole, end, cut = block.rpartition(b"\n")
            if end:
                yield rest + whole + end
            rest = cut if end else rest + block
        yield rest
