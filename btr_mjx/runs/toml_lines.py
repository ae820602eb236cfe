"""Lines of a TOML file that errors speak of."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs.bounded_files import read_text

_HEAD = re.compile(r"\s*\[(\[?)\s*([\w.-]+)\s*\]")
_KEY = re.compile(r"\s*(?:\"([^\"]+)\"|'([^']+)'|([\w.-]+))\s*=")


@contextmanager
def naming_lines(path: Path) -> Iterator[None]:
    """Errors of input that begin with a TOML file's path also say the line, where `line_of` finds it.

    Raises:
      InputError: what the block raises, of the same class.
    """
    try:
        yield
    except InputError as error:
        prefix, text = f"{path}: ", str(error)
        if text.startswith(prefix):
            try:
                line = line_of(read_text(path), text.removeprefix(prefix))
            except (OSError, DamagedFile):
                line = None
            if line is not None:
                error.args = (f"{path}, line {line}: {text.removeprefix(prefix)}", *error.args[1:])
        raise


def line_of(toml: str, message: str) -> int | None:
    """The line of a TOML text that a message speaks of: it begins with the table, if any, and names the key.

    Args:
      toml: the text.
      message: such as "[[parameter]] 2: bounds = [1, 0]: expected ...", or "unknown key 'modle'".

    Returns:
      Counted from 1: of the key that is named first, else of the table's head; None where neither is there.
    """
    found = re.match(r"\[\[([\w.-]+)\]\] (\d+)|\[([\w.-]+)\]", message)
    table, number = (found[1] or found[3], int(found[2] or 1)) if found else ("", 1)
    here, count, head, keys = "", 0, None, dict[str, int]()
    for line, text in enumerate(toml.splitlines(), 1):
        if opened := _HEAD.match(text):
            here = opened[2]
            count += here == table
            if here == table and count == number:
                head = line
            if not table:
                keys.setdefault(here, line)
        elif here == table and (not table or count == number) and (key := _KEY.match(text)):
            keys.setdefault(key[1] or key[2] or key[3], line)
    named = [(place.start(), line) for key, line in keys.items() if (place := _mention(key, message))]
    return min(named)[1] if named else head


def _mention(key: str, message: str) -> re.Match[str] | None:
    """Where a message names a key: first of all, in quotes, or with its value; a word of a sentence is none."""
    name = re.escape(key)
    return re.search(rf"(?:^|\]\]? \d+: |\]:? ){name}(?![\w.-])|(['\"]){name}\1|(?<![\w.-]){name} = ", message)
