"""A folder of block files, each named by the digest of the content that it was computed from."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from btr_mjx.errors import DamagedFile
from btr_mjx.runs import note, read_arrays, write_arrays

_NAME = "__name__"
"""Array that holds the name, so that a file under another block's name is noticed."""


@dataclass(frozen=True)
class BlockFiles:
    """Files of finished blocks.

    Attributes:
      folder: where they lie; None keeps nothing.
    """

    folder: Path | None

    def read(self, name: str) -> dict[str, np.ndarray] | None:
        """The arrays of a block; None where they are missing or, which prints a line, damaged.

        Raises:
          OSError: the file cannot be read.
        """
        if self.folder is None:
            return None
        path = self.folder / f"{name}.npz"
        try:
            arrays = read_arrays(path, require_digest=True)
            if str(arrays.pop(_NAME, "")) != name:
                raise DamagedFile(f"{path}: holds another block")
        except FileNotFoundError:
            return None
        except DamagedFile as error:
            note(f"warning: {error}; the block is computed again")
            return None
        return arrays

    def write(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the arrays of a block.

        Raises:
          OSError: the file cannot be written.
        """
        if self.folder is not None:
            write_arrays(self.folder / f"{name}.npz", {_NAME: np.array(name), **arrays})
