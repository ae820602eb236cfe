"""Findings of the checks: one line about a dataset, with a level."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Level = Literal["error", "warning", "note"]
_MAX_NAMES = 6
"""Names listed in one finding; the rest is counted."""


@dataclass(frozen=True)
class Finding:
    """A result of a check of a dataset.

    Attributes:
      level: "error", "warning" or "note".
      topic: one or two words.
      message: one line of text.
    """

    level: Level
    topic: str
    message: str


def listed(names: Sequence[str]) -> str:
    """Names separated by commas; after `_MAX_NAMES` only their count."""
    return ", ".join(names[:_MAX_NAMES]) + (f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else "")
