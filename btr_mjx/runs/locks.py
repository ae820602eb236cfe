"""Lock of a run folder: only one process writes to it at a time."""

import errno
import os
import time
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.runs.progress_bar import note

LOCK_NAME = ".lock"
"""Name of the lock file in a folder."""

LOCK_TIMEOUT = 1.0
"""Time for which a lock is tried before its folder counts as in use [s]."""


def take_lock(folder: Path) -> int | None:
    """Lock a folder against other processes; a descriptor to close when done, None on systems without `flock`.

    The operating system releases the lock when the process ends, in whatever way. The lock file stays behind; its
    presence alone means nothing.

    Raises:
      InputError: another process (or this one, a second time) is writing to the folder.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    descriptor = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT, 0o644)
    until = time.monotonic() + LOCK_TIMEOUT
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):  # a network drive without locks
                note(f"warning: {folder} cannot be locked ({error.strerror}); take care that one process writes to it")
                return descriptor
        # A child process (such as git) of a killed run holds the inherited descriptor until its exec.
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
