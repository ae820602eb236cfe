"""Parts of a page: sections with figures, tables and lines of text."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from btr_mjx.gap.results import format_number

_NUMBER = r"\N{MINUS SIGN}?\d[\d.]*(·10\^\N{MINUS SIGN}?\d+)?( \[.*\])?"
"""Pattern of what `format_number` and `with_interval` write."""


@dataclass(frozen=True)
class Figure:
    """A figure inside a page.

    Attributes:
      data: the PNG as base64.
      alt: what it shows, for readers who do not see it.
      caption: below it.
      photo: a picture of a robot, whose colours a dark page keeps.
    """

    data: str
    alt: str
    caption: str
    photo: bool = False


@dataclass(frozen=True)
class Table:
    """A table whose rows can be sorted by a click on a column's head.

    Attributes:
      columns: names, with units.
      rows: cells, text or numbers; None is an empty cell.
      note: below it.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    note: str = ""

    @property
    def numeric(self) -> list[bool]:
        """Whether each column holds numbers, or numbers with intervals."""
        columns = list(zip(*self.rows, strict=True)) or [()] * len(self.columns)
        kinds = [[cell for cell in column if cell is not None] for column in columns]
        return [bool(cells) and all(map(_is_numeric, cells)) for cells in kinds]


@dataclass(frozen=True)
class Curves:
    """Curves over time that a reader can zoom and read off; not more than three.

    Attributes:
      title: what they show.
      unit: of the values.
      time: (K,) [s].
      lines: values (K,) by name, the measured ones first; None is a gap.
    """

    title: str
    unit: str
    time: Sequence[float]
    lines: Mapping[str, Sequence[float | None]]


@dataclass(frozen=True)
class Section:
    """A part of a page under its own heading.

    Attributes:
      title: the heading.
      lines: sentences, a list item each.
      figures: shown below them.
      tables: shown below the figures and curves.
      folded: closed until the reader opens it.
      curves: shown below the figures.
      code: shown last.
    """

    title: str
    lines: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    folded: bool = False
    curves: Sequence[Curves] = ()
    code: str = ""

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing below the heading."""
        return not (self.lines or self.figures or self.tables or self.curves or self.code)


def _is_numeric(cell: Any) -> bool:
    return isinstance(cell, int | float) or (isinstance(cell, str) and bool(re.fullmatch(_NUMBER, cell)))


def cell_text(value: Any) -> str:
    """A cell of a table as text; whole numbers keep all digits."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value).replace("-", "\N{MINUS SIGN}")
    if isinstance(value, float):
        return format_number(value, 4) if math.isfinite(value) else "–"
    return str(value)


def cell_order(value: Any) -> str:
    """What a cell is sorted by."""
    return repr(float(value)) if isinstance(value, int | float) and math.isfinite(value) else cell_text(value)


def with_interval(value: float, low: float, high: float) -> str:
    """A number and its interval, such as "0.31 [0.28, 0.35]"."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return format_number(value)
    return f"{format_number(value)} [{format_number(low)}, {format_number(high)}]"


def flat_rows(settings: Any, prefix: str = "") -> list[list[str]]:
    """Names and values of settings, nested ones as a.b."""
    rows: list[list[str]] = []
    for name, value in settings.items():
        if isinstance(value, dict) and value:
            rows += flat_rows(value, f"{prefix}{name}.")
        elif isinstance(value, list):
            rows.append([prefix + name, " ".join(map(str, value))])
        elif value is not None:
            rows.append([prefix + name, str(value).lower() if isinstance(value, bool) else str(value)])
    return [row for row in rows if row[1]]
