"""Findings of the checks: one line about a dataset, with a level, numbers and a remedy."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Level = Literal["error", "warning", "note"]
DEGREES_REMEDY = 'angles are in rad: name the column ..._deg, or put "COLUMN" = "deg" into [units] of dataset.toml'


@dataclass(frozen=True)
class Finding:
    """A result of a check of a dataset.

    Attributes:
      level: "error", "warning" or "note".
      topic: one or two words.
      message: one line of text, with the evidence and the remedy.
      remedy: what to change, where one change mends it; "" otherwise.
      evidence: numbers behind it, by name.
      lines: what to write into dataset.toml, where that takes more than the message.
    """

    level: Level
    topic: str
    message: str
    remedy: str = ""
    evidence: Mapping[str, float] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
