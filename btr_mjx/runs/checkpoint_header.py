"""The JSON text of a checkpoint, checked before anything relies on its form."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from btr_mjx.errors import DamagedFile
from btr_mjx.runs.bounded_files import check_plain


def read_checkpoint_header(text: np.ndarray, where: str) -> dict[str, Any]:
    """The object with format, step, meta, tables and files.

    Args:
      text: UTF-8 bytes of the JSON, which may hold NaN and infinities.
      where: the file, for messages.

    Raises:
      DamagedFile: not such an object.
    """
    try:
        header = json.loads(text.tobytes())
    except (ValueError, RecursionError) as error:
        raise DamagedFile(f"{where}: not a checkpoint ({error})") from None
    check_plain(header, where)
    good = (
        isinstance(header, Mapping)
        and type(header.get("format")) is int
        and type(header.get("step")) is int
        and isinstance(header.get("meta"), Mapping)
        and isinstance(header.get("tables"), Mapping)
        and all(_is_table(rows) for rows in header["tables"].values())
        and isinstance(header.get("files"), Mapping)
        and all(isinstance(digest, str) for digest in header["files"].values())
    )
    if not good:
        raise DamagedFile(f"{where}: not a checkpoint (its header has no format, step, meta, tables and files)")
    return dict(header)


def _is_table(rows: Any) -> bool:
    return isinstance(rows, list) and all(isinstance(row, Mapping) for row in rows)
