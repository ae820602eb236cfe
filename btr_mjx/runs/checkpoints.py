"""Checkpoints: the state of a run after a step, each one file that vouches for itself.

`checkpoint-000012.npz` holds the arrays of step 12, a JSON text with everything else, and the SHA-256 of the whole
file. Because it is one file, written atomically, no kill can leave arrays and text of two different steps. The last
few are kept, so a file that the disk damaged later costs some steps and not the run.

The text may hold NaN and infinities and returns them as floats (it is read by this module alone); tuples come back as
lists.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs.files import read_arrays, to_plain, write_arrays
from btr_mjx.runs.progress_bar import note

FORMAT = 1
META_NAME = "__meta__"
_FILE_NAME = re.compile(r"checkpoint-(\d{6,})\.npz")
BIT_GENERATORS: Mapping[str, type[np.random.BitGenerator]] = {
    "PCG64": np.random.PCG64,
    "PCG64DXSM": np.random.PCG64DXSM,
    "MT19937": np.random.MT19937,
    "Philox": np.random.Philox,
    "SFC64": np.random.SFC64,
}


@dataclass(frozen=True)
class Checkpoint:
    """What a run needs to go on after `step`."""

    step: int
    arrays: dict[str, np.ndarray]
    meta: dict[str, Any]
    rows: dict[str, int]
    """Table name -> number of rows that belong to this step; see `btr_mjx.runs.folder.History`."""


def checkpoint_path(folder: str | Path, step: int) -> Path:
    """The file that holds the checkpoint of `step`."""
    return Path(folder) / f"checkpoint-{step:06d}.npz"


def list_checkpoints(folder: str | Path) -> list[tuple[int, Path]]:
    """The (step, file) of every checkpoint in the folder, oldest first, sound or not."""
    matches = [(_FILE_NAME.fullmatch(path.name), path) for path in Path(folder).iterdir()]
    return sorted((int(match.group(1)), path) for match, path in matches if match)


def save_checkpoint(
    folder: str | Path,
    step: int,
    arrays: Mapping[str, Any],
    meta: Mapping[str, Any] | None = None,
    *,
    rows: Mapping[str, int] | None = None,
    keep: int = 2,
) -> Path:
    """Write the state after `step`, then delete what is no longer needed.

    Of the steps up to this one the last `keep` stay. Files of later steps are deleted: they belong to a course of the
    run that a resume from an earlier checkpoint has left.

    Args:
      folder: the run folder.
      step: 0, 1, 2, ...
      arrays: name -> array; bools, integers and floats of any width, bit for bit. Names with "__" in front are ours.
      meta: JSON-able values; NaN and infinities are kept.
      rows: number of rows per history table.
      keep: how many checkpoints stay, at least 2.

    Returns:
      The file written.

    Raises:
      TypeError: an array or a value that cannot be saved.
      ValueError: negative step, keep < 2 or a reserved array name.
      OSError: the file cannot be written.
    """
    if step < 0 or keep < 2:
        raise ValueError(f"expected step >= 0 and keep >= 2, got step {step} and keep {keep}")
    if reserved := [name for name in arrays if name.startswith("__")]:
        raise ValueError(f"array names must not begin with '__', got {reserved}")
    header = {"format": FORMAT, "step": step, "meta": dict(meta or {}), "rows": dict(rows or {})}
    text = json.dumps(to_plain(header, strict=False)).encode("utf-8")
    path = checkpoint_path(folder, step)
    write_arrays(path, {META_NAME: np.frombuffer(text, np.uint8), **arrays})
    for later in [old for saved, old in list_checkpoints(folder) if saved > step]:
        later.unlink(missing_ok=True)
    drop_older(folder, step, keep)
    return path


def drop_older(folder: str | Path, step: int, keep: int) -> None:
    """Delete the checkpoints of steps up to `step` but for the last `keep`.

    Raises:
      OSError: a file cannot be deleted.
    """
    for old in [path for saved, path in list_checkpoints(folder) if saved <= step][:-keep]:
        old.unlink(missing_ok=True)


def read_checkpoint(path: str | Path) -> Checkpoint:
    """Read one checkpoint and verify its checksum.

    Raises:
      DamagedFile: cut short, altered, renamed or not a checkpoint.
      OSError: the file cannot be read.
    """
    arrays = read_arrays(path, require_digest=True)
    if META_NAME not in arrays:
        raise DamagedFile(f"{path}: not a checkpoint")
    header = json.loads(arrays.pop(META_NAME).tobytes())
    if header["format"] != FORMAT:
        raise DamagedFile(f"{path}: checkpoint format {header['format']}, this version reads {FORMAT}")
    match = _FILE_NAME.fullmatch(Path(path).name)
    if match and int(match.group(1)) != header["step"]:
        raise DamagedFile(f"{path}: was renamed, it holds step {header['step']}")
    return Checkpoint(header["step"], arrays, header["meta"], header["rows"])


def load_latest(folder: str | Path, *, warn: Callable[[str], None] = note) -> Checkpoint | None:
    """Load the newest sound checkpoint.

    Args:
      folder: the run folder.
      warn: gets one line for each damaged file that was passed over.

    Returns:
      The checkpoint, or None where none was ever written.

    Raises:
      DamagedFile: there are checkpoints and none is sound.
      OSError: a file cannot be read.
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


def generator_to_json(generator: np.random.Generator) -> dict[str, Any]:
    """The whole state of a numpy Generator, so that its next draws and its next `spawn` are the same.

    Integers that a double cannot hold (PCG64 has 128 bits) are written as "0x..." strings, so any JSON reader keeps
    them.

    Raises:
      ValueError: a bit generator that numpy does not ship.
    """
    bits = generator.bit_generator
    state = dict(bits.state)
    if state["bit_generator"] not in BIT_GENERATORS:
        raise ValueError(f"expected one of {', '.join(BIT_GENERATORS)}, got {state['bit_generator']}")
    seeds = bits.seed_seq
    if isinstance(seeds, np.random.SeedSequence):
        state["seed_sequence"] = seeds.state
    return _pack(state)


def generator_from_json(data: Mapping[str, Any]) -> np.random.Generator:
    """Rebuild the Generator that `generator_to_json` described.

    Raises:
      InputError: not such a description.
    """
    name = str(data.get("bit_generator"))
    if name not in BIT_GENERATORS:
        raise InputError(f"generator state: expected bit_generator of {', '.join(BIT_GENERATORS)}, got {name!r}")
    try:
        state = _unpack(data)
        seeds = state.pop("seed_sequence", None)
        # The seed is overwritten below; it only keeps `spawn` in step, and no entropy is drawn from the system.
        bits = BIT_GENERATORS[name](np.random.SeedSequence(**seeds) if seeds else 0)
        bits.state = state
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"generator state: not a valid state of {name} ({error})") from error
    return np.random.Generator(bits)


def _pack(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {"dtype": value.dtype.name, "values": [_pack(item) for item in value.tolist()]}
    if isinstance(value, Mapping):
        return {key: _pack(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_pack(item) for item in value]
    if isinstance(value, int | np.integer) and not -(2**53) <= value <= 2**53:
        return hex(value)
    return to_plain(value)


def _unpack(value: Any) -> Any:
    if isinstance(value, Mapping) and set(value) == {"dtype", "values"}:
        return np.array([_unpack(item) for item in value["values"]], np.dtype(value["dtype"]))
    if isinstance(value, Mapping):
        return {key: _unpack(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_unpack(item) for item in value]
    if isinstance(value, str) and value.startswith("0x"):
        return int(value, 16)
    return value
