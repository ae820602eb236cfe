"""What to write into dataset.toml where columns cannot be matched by their names."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from btr_mjx.errors import InputError, command_line
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import nearest_names


@dataclass(frozen=True)
class Answer:
    """The dataset.toml in which a user says what the columns of a log are.

    Attributes:
      file: where it is, or has to be written.
      head: what it begins with where there is none yet: the model and the recordings.
    """

    file: Path = Path("dataset.toml")
    head: str = ""

    def asked(self, message: str, near: Mapping[str, Sequence[str]], joints: Sequence[str] = ()) -> InputError:
        """The error that asks for columns, with the lines to write and the command to run then.

        `near` has columns of the file that may be it, by each column of the model; `joints` may have no encoder.
        """
        lines = [
            f'"NAME {i}" = {quoted(target)}  # nearest: {nearest_names(target.partition("/")[2] or target, columns)}'
            for i, (target, columns) in enumerate(near.items(), 1)
        ]
        silent = any(target.startswith("ctrl/") and not columns for target, columns in near.items())
        return self.error(message, lines, joints, silent)

    def error(self, message: str, lines: Sequence[str], joints: Sequence[str] = (), silent: bool = False) -> InputError:
        """An error with lines of the table [columns]; `joints` may have no encoder, `silent` commands no column."""
        fill = "with names of the file in place of NAME 1, ..." if any("NAME " in line for line in lines) else ""
        without = [
            f"(a joint without an encoder has no line there, but below [model]: unmeasured = [{quoted(joint)}])"
            for joint in joints[:1]
        ]
        if silent:
            without.append(
                "(where a command was not logged, add a column of it, or leave the actuator, and joints that stood "
                "still, out of a copy of the model)"
            )
        block = self.lines(["[columns]", *lines], fill, without)
        return InputError(f"{message}; name them in [columns] of {self.file}", lines=block)

    def lines(self, tables: Sequence[str], fill: str = "", more: Sequence[str] = ()) -> list[str]:
        """What to write into the file, and to run then: tables of TOML, what to `fill` in, and `more` that explains."""
        where = f"Write this to {self.file}" if self.head else f"Add this to {self.file}"
        head = [*self.head.rstrip().splitlines(), ""] if self.head else []
        if not self.head and (twice := [line for line in tables if line in self._headings()]):
            more = [
                f"({listed(twice)} is there already: its lines go below it, in place of those of the same names)",
                *more,
            ]
        run = f"then run: {command_line('btr_mjx.diagnose', [str(self.file.parent)])}"
        return [f"{where}{f', {fill}' if fill else ''}:", "", *head, *tables, "", *more, run]

    def _headings(self) -> list[str]:
        """The lines of the file that begin a table."""
        text = self.file.read_text(encoding="utf-8", errors="replace") if self.file.is_file() else ""
        return [line.strip() for line in text.splitlines() if line.startswith("[")]


NO_FILE = Answer()
"""Where nothing is known of a dataset.toml."""


def quoted(text: str) -> str:
    """A text as a string of TOML."""
    return json.dumps(text, ensure_ascii=False)
