"""Digests under which answers are kept: of the code that computes them, and of the data that they are of."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import scipy

import btr_mjx

ROOMS_OUTSIDE_SEARCH = (
    *("backtoreality", "cluster", "demo", "engines", "evaluation", "optimise", "pages", "plotting", "replays"),
    *("gap/experiments", "gap/fitness_only", "gap/report"),
)
"""Rooms that a search with its checks does not import. It does not import the commands at the top either."""


def _digest(root: Path, counts: Callable[[Path], bool], more: str = "") -> str:
    """SHA-256 of a text and of the selected files with their names; the first 12 hexadecimal digits."""
    total = hashlib.sha256(more.encode())
    for name in sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()):
        if counts(Path(name)):
            content = (root / name).read_bytes()
            total.update(f"\n{name} {len(content)}\n".encode() + content)
    return total.hexdigest()[:12]


def code_digest(package: Path) -> str:
    """Digest of the code on which an answer depends: modules of a package and versions of libraries.

    Args:
      package: folder of btr_mjx.

    Returns:
      12 hexadecimal digits.
    """

    def counts(path: Path) -> bool:
        if len(path.parts) == 1:
            return path.name == "errors.py"
        return path.suffix == ".py" and not any(path.is_relative_to(room) for room in ROOMS_OUTSIDE_SEARCH)

    return _digest(package, counts, ", ".join(f"{lib.__name__} {lib.__version__}" for lib in (mujoco, np, scipy)))


@cache
def data_digest(folder: Path) -> str:
    """Digest of a dataset; cached, as recordings do not change."""
    return _digest(folder, lambda _: True)


CODE = code_digest(Path(str(btr_mjx.__file__)).parent)
"""Digest of the code that this process imported."""
