"""Checks of folders: can they be written to, is there space, do locks exclude, are renames atomic.

Everything is tried in a temporary folder that is removed again. A folder that does not exist yet stands for its nearest
parent that does.
"""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from btr_mjx.health.result import CheckResult

MIB = 2**20
"""Bytes of a MiB."""

SPACE_WARNING, SPACE_OFF = 1024 * MIB, 100 * MIB
"""Free space below which a check warns or fails [bytes]; a run of the paper's settings saves tens of MiB."""


def nearest_folder(path: Path) -> Path:
    """The path itself, or its nearest parent that exists."""
    path = path.absolute()
    return next(folder for folder in (path, *path.parents) if folder.exists())


@contextmanager
def scratch_folder(path: Path) -> Iterator[Path]:
    """A temporary folder on the file system of a path, removed at the end.

    Raises:
      OSError: nothing can be written there.
    """
    with tempfile.TemporaryDirectory(prefix=".btr_mjx-", dir=nearest_folder(path), ignore_cleanup_errors=True) as name:
        yield Path(name)


def measure_space(path: Path) -> dict[str, Any]:
    """Write and flush a MiB in a folder.

    Returns:
      folder, free [bytes], files (free inodes, None where unlimited) and error (None, or why writing failed).
    """
    folder = nearest_folder(path)
    error = None
    try:
        with scratch_folder(folder) as scratch, (scratch / "block").open("wb") as file:
            file.write(bytes(MIB))
            file.flush()
            os.fsync(file.fileno())
            os.replace(scratch / "block", scratch / "renamed")
    except OSError as reason:
        error = reason.strerror or str(reason)
    files = None
    if hasattr(os, "statvfs") and (status := os.statvfs(folder)).f_files:
        files = status.f_favail
    return {"folder": str(folder), "free": shutil.disk_usage(folder).free, "files": files, "error": error}


def judge_space(found: dict[str, Any], remedy: str) -> CheckResult:
    """Judge what `measure_space` returns.

    Args:
      found: the measurement.
      remedy: how to choose another folder.

    Returns:
      off where nothing can be written or less than 100 MiB are free, warning below 1 GiB.
    """
    where, free = found["folder"], found["free"]
    if found["error"] is not None:
        return CheckResult("off", f"{where} cannot be written to: {found['error']}", remedy)
    if found["files"] is not None and found["files"] < 100:
        return CheckResult(
            "off", f"{where}: {found['files']} more files can be made there", f"delete files, or {remedy}"
        )
    text = f"{where}: {free / 1024 / MIB:.1f} GiB free"
    if free < SPACE_OFF:
        return CheckResult("off", text, f"delete files, or {remedy}")
    return (
        CheckResult("warning", text, f"delete files, or {remedy}") if free < SPACE_WARNING else CheckResult("ok", text)
    )


def measure_locks(path: Path) -> dict[str, Any]:
    """Lock one file twice.

    Returns:
      folder, supported (whether this system has flock), excludes (whether the second lock was refused) and error (None,
      or why the first one failed).
    """
    folder = nearest_folder(path)
    found: dict[str, Any] = {"folder": str(folder), "supported": True, "excludes": False, "error": None}
    try:
        import fcntl
    except ImportError:  # Windows
        return found | {"supported": False}
    descriptors: list[int] = []
    try:
        with scratch_folder(folder) as scratch:
            try:
                # Locks belong to open files: two descriptors of one process exclude each other as two processes do.
                descriptors += [os.open(scratch / "lock", os.O_RDWR | os.O_CREAT, 0o644) for _ in range(2)]
                fcntl.flock(descriptors[0], fcntl.LOCK_EX | fcntl.LOCK_NB)
                try:
                    fcntl.flock(descriptors[1], fcntl.LOCK_EX | fcntl.LOCK_NB)
                except OSError as refusal:
                    found["excludes"] = refusal.errno in (errno.EWOULDBLOCK, errno.EACCES)
            finally:
                for descriptor in descriptors:
                    os.close(descriptor)
    except OSError as reason:
        found["error"] = reason.strerror or str(reason)
    return found


def judge_locks(found: dict[str, Any]) -> CheckResult:
    """Judge what `measure_locks` returns: off where locks fail, warning where the system has none."""
    remedy = "keep runs on a local disk (--out), or take care that one process writes to a run folder"
    if not found["supported"]:
        return CheckResult("warning", "this system has no flock", remedy)
    if found["error"] is not None:
        return CheckResult("off", f"{found['folder']} cannot be locked: {found['error']}", remedy)
    if not found["excludes"]:
        return CheckResult("off", f"{found['folder']}: a lock does not keep others out", remedy)
    return CheckResult("ok", f"{found['folder']}: a lock keeps others out")
