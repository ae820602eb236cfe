"""Parquet files of other programs are read in a child process first: damaged ones can end the process that reads them.

In polars a damaged length may abort the process, a panic does not derive from Exception, and both write many lines.
What the child reads without an error is read again here. A change that leaves a valid file with other numbers cannot
be detected in files without a digest (see `parquet_digest`).
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from btr_mjx.errors import DamagedFile
from btr_mjx.runs.bounded_files import MAX_TABLE_BYTES, check_regular
from btr_mjx.runs.parquet_digest import has_digest

SECONDS = 60.0
"""Time in which a child has to read a file that takes no longer than a moment by its size [s]."""

BYTES_PER_SECOND = 5e6
"""Time that a large file adds: its size over this."""

_CHILD = Path(__file__).with_name("parquet_child.py")


def check_parquet(paths: Sequence[Path]) -> None:
    """Check that files without a digest can be read; the others are verified when they are read.

    Raises:
      InputError: a file that is too large, or no regular file.
      DamagedFile: the first file that cannot be read.
    """
    for path in paths:
        check_regular(path, MAX_TABLE_BYTES)
    for path, problem in unreadable_parquet([path for path in paths if not has_digest(path)]).items():
        raise DamagedFile(f"{path}: not a readable parquet table ({problem})")


def unreadable_parquet(paths: Sequence[Path]) -> dict[Path, str]:
    """Which files cannot be read, and why; one child process reads all of them unless a file ends it."""
    problems: dict[Path, str] = {}
    left = list(paths)
    while left:
        answers, ending = _ask(left)
        for path, answer in zip(left, answers, strict=False):
            if answer is not None:
                problems[path] = answer
        if len(answers) < len(left):
            problems[left[len(answers)]] = ending
        left = left[len(answers) + 1 :]
    return problems


def _ask(paths: Sequence[Path]) -> tuple[list[str | None], str]:
    """Answers of one child process, and how it ended where it did not answer for all files."""
    seconds = SECONDS + sum(path.stat().st_size for path in paths) / BYTES_PER_SECOND
    environment = os.environ | {"POLARS_MAX_THREADS": "1", "RUST_BACKTRACE": "0"}
    try:
        done = subprocess.run(
            [sys.executable, "-I", str(_CHILD)],
            input=json.dumps([str(path.absolute()) for path in paths]).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            timeout=seconds,
            check=False,
        )
        output, ending = done.stdout, "it ends the process that reads it"
    except subprocess.TimeoutExpired as error:
        output, ending = error.stdout or b"", f"it could not be read within {seconds:.0f} s"
    return [json.loads(line) for line in output.splitlines() if line.endswith((b"l", b'"'))], ending
