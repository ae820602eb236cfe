"""Words of a command line: they become a config, and one that is wrong becomes an error of one line."""

import inspect
import io
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from typing import Any

import tyro

from btr_mjx.errors import BAD_INPUT_CODE, InputError

_QUIET, _WITHOUT_PROGRESS = "--quiet", "--no-progress"
"""Two names of one flag."""


def parsed[T](
    kind: Callable[..., T],
    words: Sequence[str] | None,
    *,
    prog: str,
    description: str | None = None,
    default: T | None = None,
) -> T:
    """The config that a command line asks for.

    `--quiet` is `--no-progress`; commands without progress take it too, as they print results only.

    Args:
      kind: dataclass of the config, every field a flag.
      words: of the command line; None for those of this process.
      prog: name of the command.
      description: text of the help, above the flags.
      default: config with other defaults.

    Raises:
      InputError: a word that is wrong or missing.
      SystemExit: the help was asked for, and is printed.
    """
    instead = [_WITHOUT_PROGRESS] if "progress" in inspect.signature(kind).parameters else []
    every = sys.argv[1:] if words is None else words
    given = [own for word in every for own in (instead if word == _QUIET else [word])]
    more: dict[str, Any] = {} if default is None else {"default": default}
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            return tyro.cli(kind, args=given, prog=prog, description=description, **more)
    except SystemExit as end:
        if end.code != BAD_INPUT_CODE:
            raise
        told = said.getvalue()
    raise InputError(f"{_told(told)}; {prog} --help describes all flags")


def _told(box: str) -> str:
    """What tyro says of wrong words, without the box around it and the help of flags."""
    rows = [line.strip("│| ") for line in box.splitlines()[1:]]  # the first one is a title
    rules = [i for i, row in enumerate(rows) if not row.strip("╰─╯+- ")] or [len(rows)]
    inner = [i for i in rules if i > 0] or [len(rows)]
    what = " ".join(row for row in rows[: inner[0]] if row.strip("╰─╯+- ")).partition(" Got errors:")[0]
    near = [row for row in rows[inner[0] :] if row.startswith("--") and row.strip("╰─╯+- ")]
    meant = f" (perhaps {near[0].split(',')[0].split(' ')[0]})" if "Perhaps you meant:" in rows and near else ""
    return what.rstrip(".") + meant
