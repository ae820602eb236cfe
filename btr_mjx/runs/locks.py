"""One writer for a folder at a time."""

import errno
import os
import time
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.runs.progress_bar import note

LOCK_NAME = ".lock"
PATIENCE = 1.0
"""Seconds for which a lock is asked for again before its folder is called in use."""


def take_lock(folder: Path) -> int | None:
    """Lock a folder against other processes.

    The operating system drops the lock with the process that holds it, however that ends. The lock file stays behind
    and says nothing by its presence.

    Returns:
      A descriptor to close when done; None on systems without `flock`.

    Raises:
      InputError: another process (or this one, a second time) is writing to the folder.
      OSError: the lock file cannot be opened.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    descriptor = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT, 0o644)
    until = time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):  # a network drive that knows no locks
                note(f"warning: {folder} cannot be locked ({error.strerror}); take care that one process writes to it")
                return descriptor
        # What a killed run was starting (git, say) has its descriptors until it is another program.
        if time.monotonic() < until:
            time.sleep(0.02)
            continue
        holder = os.read(descriptor, 32).decode("ascii", "replace").strip() or "unknown"
        os.close(descriptor)
        raise InputError(
            f"{folder} is in use by another run (process {holder}); wait for it, stop it or choose another --out"
        ) from None
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"{os.getpid()}\n".encode("ascii"))
    return descriptor
