"""What preflight says: one line about a dataset, and how bad it is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Level = Literal["error", "warning", "note"]
_FEW = 6
"""So many names are listed in one finding."""


@dataclass(frozen=True)
class Finding:
    """Something about a dataset.

    Attributes:
      level: "error", "warning" or "note".
      topic: what it is about, in one or two words.
      message: one line.
    """

    level: Level
    topic: str
    message: str


def listed(names: Sequence[str]) -> str:
    """Names, the first few of many."""
    return ", ".join(names[:_FEW]) + (f" and {len(names) - _FEW} more" if len(names) > _FEW else "")
