"""A row for each case, the same for all suites, and the table of their counts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

NO_ANSWER = "no answer"
"""Verdict of a case whose process crashed, hung or refused the data."""


@dataclass(frozen=True)
class Row:
    """What was hidden in a case, what was said of it, and whether that is right.

    Attributes:
      hidden: what is missing, as effect@place.
      said: the verdict, or `NO_ANSWER`.
      named: effects of the answer.
      right: None where the truth cannot be detected.
      false_names: effects of the answer that are not hidden.
      is_null: whether nothing is hidden.
      numbers: true numbers that the answer has intervals for.
      inside: those within their intervals.
      cpu_seconds: of the process that solved the case [s]; None without an answer.
      sentence: the outcome in words.
      case: name of the case.
      suite: name of its suite.
    """

    hidden: str
    said: str
    named: tuple[str, ...]
    right: bool | None
    false_names: tuple[str, ...]
    is_null: bool
    numbers: int
    inside: int
    cpu_seconds: float | None
    sentence: str
    case: str = ""
    suite: str = ""

    @classmethod
    def read(cls, entry: Mapping[str, Any]) -> "Row":
        """A row that was written as JSON."""
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()}
        return cls(**values)

    @property
    def words(self) -> str:
        """The answer, and whether it is right where that can be decided."""
        said = f"{self.said}: {listed(self.named)}" if self.named or self.said == "effect" else self.said
        return said + {None: "", True: " (right)", False: " (wrong)"}[self.right]


def listed(names: Sequence[str]) -> str:
    """Names in a line."""
    return " + ".join(names) or "nothing"


def name_of(effect: Mapping[str, Any]) -> str:
    """effect@place of an entry of a truth or of an answer."""
    return f"{effect['effect']}@{effect['location']}"


def row_of(
    answer: Mapping[str, Any],
    hidden: str,
    right: bool | None,
    false_names: Sequence[str] = (),
    *,
    is_null: bool = False,
    inside: Sequence[bool] = (),
) -> Row:
    """A row without the names of case and suite.

    Args:
      answer: to the case.
      hidden: what is missing.
      right: whether the answer is right; without an answer nothing is.
      false_names: effects that are named and not hidden.
      is_null: whether nothing is hidden.
      inside: for each true number that the answer has an interval for, whether that holds it.
    """
    said, named = answer["verdict"], tuple(name_of(effect) for effect in answer["effects"])
    counted = None if right is None else bool(right) and said != NO_ANSWER
    cpu, sentence = answer.get("cpu_seconds"), str(answer.get("sentence", ""))
    return Row(hidden, said, named, counted, tuple(false_names), is_null, len(inside), int(sum(inside)), cpu, sentence)


def right_of(rows: Sequence[Row]) -> str:
    """Right answers among those that can be."""
    return f"{sum(row.right is True for row in rows)} of {sum(row.right is not None for row in rows)}"


def false_of(rows: Sequence[Row]) -> str:
    """False names where something is hidden."""
    return str(sum(len(row.false_names) for row in rows if not row.is_null))


def nulls_of(rows: Sequence[Row]) -> str:
    """Nulls in which something is named."""
    return f"{sum(bool(row.named) for row in rows if row.is_null)} of {sum(row.is_null for row in rows)}"


def inside_of(rows: Sequence[Row]) -> str:
    """True numbers within their intervals."""
    return f"{sum(row.inside for row in rows)} of {sum(row.numbers for row in rows)}"


def _seconds(reduce: Callable[[list[float]], Any]) -> Callable[[Sequence[Row]], str]:
    return lambda rows: f"{reduce([row.cpu_seconds for row in rows if row.cpu_seconds is not None] or [np.nan]):.0f}"


COLUMNS: Mapping[str, Callable[[Sequence[Row]], str]] = {
    "cases": lambda rows: str(len(rows)),
    "right": right_of,
    "false names": false_of,
    "nulls named": nulls_of,
    "in intervals": inside_of,
    "unexplained": lambda rows: str(sum(row.said == "unexplained" for row in rows)),
    NO_ANSWER: lambda rows: str(sum(row.said == NO_ANSWER for row in rows)),
    "CPU-s": _seconds(np.median),
    "largest": _seconds(max),
}
"""Columns of the table: titles, and what rows amount to."""


def by_suite(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows of each suite, in order, and of all where there are several."""
    suites = {suite: [row for row in rows if row.suite == suite] for suite in dict.fromkeys(row.suite for row in rows)}
    return suites | ({"all": list(rows)} if len(suites) > 1 else {})


def show(rows: Sequence[Row]) -> None:
    """Print the counts of each suite, and every answer that is not right."""
    print(f"{'suite':20}" + "".join(f"{title:>13}" for title in COLUMNS))
    for suite, own in by_suite(rows).items():
        print(f"{suite:20}" + "".join(f"{cell(own):>13}" for cell in COLUMNS.values()))
    wrong = [row for row in rows if row.right is False]
    for row in wrong:
        false = f"; false: {listed(row.false_names)}" if row.false_names else ""
        print(f"{row.case}, hidden {row.hidden}: {row.words}{false}")
