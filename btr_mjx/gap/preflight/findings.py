"""Findings of the checks: one line about a dataset, with a level, numbers and a remedy."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from btr_mjx.runs import write_table

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


def save_findings(findings: Sequence[Finding], path: Path) -> None:
    """Write findings as a table, a row each."""
    rows = [asdict(f) | {"evidence": json.dumps(f.evidence), "lines": "\n".join(f.lines)} for f in findings]
    write_table(path, rows)
