"""A SHA-256 inside a Parquet file, so that damage to files of this package is detected before they are parsed.

The footer's metadata hold the entry `sha256`: the digest of the whole file with zeros in the digest's place. Any reader
of Parquet reads such a file as any other. Parquet's own checksums cover pages only, not the footer, and few programs
write or check them.
"""

import hashlib
import io
import re
from pathlib import Path

import polars as pl

from btr_mjx.errors import DamagedFile

_KEY = "btr_mjx.sha256"
_BLANK = b"sha256:" + b"0" * 64
_DIGEST = re.compile(rb"sha256:[0-9a-f]{64}")
_FOOTER_BYTES = 1 << 20
"""Part of the file's end in which the digest is looked for; a footer of a thousand columns takes 100 kB."""


def parquet_with_digest(frame: pl.DataFrame) -> bytes:
    """A Parquet file of a table, with the digest in its footer."""
    buffer = io.BytesIO()
    frame.write_parquet(buffer, metadata={_KEY: _BLANK.decode()})
    data = buffer.getvalue()
    place = data.rfind(_BLANK)
    return data[:place] + b"sha256:" + hashlib.sha256(data).hexdigest().encode() + data[place + len(_BLANK) :]


def has_digest(path: Path) -> bool:
    """Whether a file says that it holds a digest."""
    with path.open("rb") as file:
        file.seek(max(0, file.seek(0, io.SEEK_END) - _FOOTER_BYTES))
        return _KEY.encode() in file.read()


def verify_digest(data: bytes, path: Path) -> bool:
    """Verify the digest of a file.

    Returns:
      True if it matches, False if the file has none (another program wrote it).

    Raises:
      DamagedFile: it does not match.
    """
    tail = max(0, len(data) - _FOOTER_BYTES)
    if _KEY.encode() not in data[tail:]:
        return False
    for found in _DIGEST.finditer(data, tail):
        blank = data[: found.start()] + _BLANK + data[found.end() :]
        if hashlib.sha256(blank).hexdigest().encode() == found[0][len(b"sha256:") :]:
            return True
    raise DamagedFile(f"{path}: the checksum does not match, the file was altered")
