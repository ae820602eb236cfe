"""Checkpoints: the state of a run after a step, each in one file with its own checksum.

`checkpoint-000012.npz` holds the arrays of step 12, a JSON text with everything else, and the SHA-256 of the whole
file. Because it is one file, written atomically, everything in it belongs to the same step: the state, the tables of
the run so far, and digests of the files that the run has finished. The last few checkpoints are kept, so that a file
damaged on disk costs a few steps and not the run.

The JSON text may hold NaN and infinities, which are read back as floats (only this module reads it). Tuples are read
back as lists.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import DamagedFile
from btr_mjx.runs.bounded_files import check_plain
from btr_mjx.runs.files import read_arrays, to_plain, write_arrays
from btr_mjx.runs.progress_bar import note

FORMAT = 2
"""Version of the file format."""

KEPT = 2
"""How many checkpoints stay."""

META_NAME = "__meta__"
"""Array that holds the JSON text."""

_FILE_NAME = re.compile(r"checkpoint-(\d{6,})\.npz")


@dataclass(frozen=True)
class Checkpoint:
    """What a run needs to continue after `step`.

    Attributes:
      step: 0, 1, 2, ...
      arrays: name -> array.
      meta: JSON-able values.
      tables: table name -> its rows up to this step; see `btr_mjx.runs.run_folder.History`.
      files: name of a file in the run folder -> its SHA-256, in hex.
    """

    step: int
    arrays: dict[str, np.ndarray]
    meta: dict[str, Any]
    tables: dict[str, list[dict[str, Any]]]
    files: dict[str, str]


def checkpoint_path(folder: str | Path, step: int) -> Path:
    """The file that holds the checkpoint of `step`."""
    return Path(folder) / f"checkpoint-{step:06d}.npz"


def list_checkpoints(folder: str | Path) -> list[tuple[int, Path]]:
    """The (step, file) of every checkpoint in the folder, oldest first, damaged ones included."""
    matches = [(_FILE_NAME.fullmatch(path.name), path) for path in Path(folder).iterdir()]
    return sorted((int(match.group(1)), path) for match, path in matches if match)


def save_checkpoint(
    folder: str | Path,
    step: int,
    arrays: Mapping[str, Any],
    meta: Mapping[str, Any] | None = None,
    *,
    tables: Mapping[str, Any] | None = None,
    files: Mapping[str, str] | None = None,
) -> Path:
    """Write the state after `step`, then delete what is no longer needed; the file written.

    Of the steps up to this one the last `KEPT` stay. Files of later steps are deleted: they were written before the run
    was resumed from an earlier checkpoint. Arrays are of bools, integers and floats of any width, kept bit for bit;
    their names do not begin with "__". Meta is JSON-able values, NaN and infinities too. `tables` has rows, `files`
    digests.
    """
    if step < 0:
        raise ValueError(f"expected step >= 0, got {step}")
    if reserved := [name for name in arrays if name.startswith("__")]:
        raise ValueError(f"array names must not begin with '__', got {reserved}")
    header = {"format": FORMAT, "step": step, "meta": meta or {}, "tables": tables or {}, "files": files or {}}
    text = json.dumps(to_plain(header, strict=False)).encode("utf-8")
    path = checkpoint_path(folder, step)
    write_arrays(path, {META_NAME: np.frombuffer(text, np.uint8), **arrays})
    for later in [old for saved, old in list_checkpoints(folder) if saved > step]:
        later.unlink(missing_ok=True)
    drop_older(folder, step)
    return path


def drop_older(folder: str | Path, step: int) -> None:
    """Delete the checkpoints of steps up to `step`, except the last `KEPT`."""
    for old in [path for saved, path in list_checkpoints(folder) if saved <= step][:-KEPT]:
        old.unlink(missing_ok=True)


def read_checkpoint(path: str | Path) -> Checkpoint:
    """Read one checkpoint and verify its checksum.

    Raises:
      DamagedFile: cut short, altered, renamed or not a checkpoint.
      OSError: the file cannot be read.
    """
    import msgspec

    arrays = read_arrays(path, require_digest=True)
    if META_NAME not in arrays:
        raise DamagedFile(f"{path}: not a checkpoint")
    try:
        header = json.loads(arrays.pop(META_NAME).tobytes())
        check_plain(header, str(path))
        found = header["format"]
        checkpoint = msgspec.convert({**header, "arrays": arrays}, Checkpoint)
    except (ValueError, RecursionError, TypeError, KeyError, msgspec.ValidationError) as error:
        raise DamagedFile(f"{path}: not a checkpoint ({error})") from None
    if found != FORMAT:
        raise DamagedFile(f"{path}: checkpoint format {found}, this version reads {FORMAT}")
    match = _FILE_NAME.fullmatch(Path(path).name)
    if match and int(match.group(1)) != checkpoint.step:
        raise DamagedFile(f"{path}: was renamed, it holds step {checkpoint.step}")
    return checkpoint


def load_latest(folder: str | Path, *, warn: Callable[[str], None] = note) -> Checkpoint | None:
    """The newest checkpoint that is not damaged, None where none was ever written.

    Raises:
      DamagedFile: there are checkpoints and all are damaged.
    """
    files = list_checkpoints(folder)
    problems = []
    for _, path in reversed(files):
        try:
            return read_checkpoint(path)
        except DamagedFile as error:
            problems.append(str(error))
            warn(f"warning: {error}; trying the checkpoint before it")
    if not files:
        return None
    raise DamagedFile(f"no sound checkpoint in {folder} ({'; '.join(problems)}); start again with another --out")
