"""SHA256SUMS: digests of the data files of a finished run.

The file has the format of the command sha256sum, so that `sha256sum -c SHA256SUMS` checks a run folder without this
package. Figures and pages may be drawn again at any time and are not listed, nor is environment.json, to which every
resume adds, nor are checkpoints and the files in folders of a run folder, which are guarded in other ways. Files that
are written once while a run goes on (`RunFolder.add_file`) are guarded by its checkpoints.
"""

import hashlib
from pathlib import Path

from btr_mjx.errors import DamagedFile
from btr_mjx.runs.atomic import atomic_write, is_temporary

SUMS_NAME = "SHA256SUMS"
"""Name of the file in a run folder."""

_NOT_LISTED = (SUMS_NAME, "environment.json", ".lock")
_CHECKPOINT = "checkpoint-*.npz"
_DRAWN = (".png", ".svg", ".pdf", ".html", ".gif", ".mp4")


def file_digest(path: Path) -> str:
    """SHA-256 of a file, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_sums(folder: Path) -> None:
    """Write SHA256SUMS with the data files of a folder."""
    files = sorted(path for path in folder.iterdir() if path.is_file() and not is_temporary(path))
    listed = [
        path
        for path in files
        if path.name not in _NOT_LISTED and path.suffix not in _DRAWN and not path.match(_CHECKPOINT)
    ]
    text = "".join(f"{file_digest(path)}  {path.name}\n" for path in listed)
    with atomic_write(folder / SUMS_NAME) as file:
        file.write(text.encode("utf-8"))


def check_sums(folder: Path) -> list[str]:
    """Check all files that SHA256SUMS lists.

    Returns:
      Their names; none where the run has not ended.

    Raises:
      DamagedFile: one is missing, or was altered.
      OSError: a file cannot be read.
    """
    names = list(_sums(folder))
    for name in names:
        if not (folder / name).is_file():
            raise DamagedFile(f"{folder / name}: {SUMS_NAME} lists it and it is missing; restore it")
        check_listed(folder / name, (folder / name).read_bytes())
    return names


def check_listed(path: str | Path, content: bytes) -> None:
    """Check the content of a file against the SHA256SUMS beside it; files that are not listed pass.

    Raises:
      DamagedFile: the content is another than the listed one.
    """
    path = Path(path)
    digest = _sums(path.parent).get(path.name)
    if digest is not None and digest != hashlib.sha256(content).hexdigest():
        raise DamagedFile(
            f"{path}: the file was altered since {SUMS_NAME} was written; restore it, or delete its line there if the "
            "change was meant"
        )


def _sums(folder: Path) -> dict[str, str]:
    """File name -> digest."""
    try:
        lines = (folder / SUMS_NAME).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return {}
    return {name.lstrip(" *"): digest for digest, _, name in (line.partition(" ") for line in lines)}
