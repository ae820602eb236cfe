"""Atomic writing: a reader finds the old file or the new one, never a part, also after a kill -9 or a power cut."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to the disk (fsync), so that renames survive a power cut; a no-op on Windows."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_temporary(path: Path) -> bool:
    """Whether this is a temporary file of `atomic_write`, which a killed process may have left behind."""
    return path.name.startswith(".") and path.name.endswith(".tmp")


@contextmanager
def atomic_write(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file that takes its name only when the block ends without an error.

    Missing folders are made. The file is readable and seekable, and is fsynced before the rename.

    Raises:
      OSError: the folder cannot be written to; an existing file keeps its content.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")
    try:
        with temporary.open("x+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def write_text(path: str | Path, text: str) -> None:
    """Write a text as UTF-8, see `atomic_write`."""
    with atomic_write(path) as file:
        file.write(text.encode("utf-8"))
