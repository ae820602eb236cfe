"""The JSON text of a checkpoint, checked before anything relies on its form."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from btr_mjx.errors import DamagedFile
from btr_mjx.runs.bounded_files import check_plain


def read_checkpoint_header(text: np.ndarray, where: str) -> dict[str, Any]:
    """The object with format, step, meta and rows.

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
        and isinstance(header.get("rows"), Mapping)
        and all(type(count) is int and count >= 0 for count in header["rows"].values())
    )
    if not good:
        raise DamagedFile(f"{where}: not a checkpoint (its header has no format, step, meta and rows)")
    return dict(header)
