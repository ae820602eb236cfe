"""Cache of simulated states on disk, so that an interrupted search resumes with bit-identical results.

A search is deterministic and spends nearly all of its time in simulations. Its own state is therefore not saved: each
result of `batch.simulate` is written to a file, and a restarted search reads these files instead of simulating.

The file name is a SHA-256 digest of the worlds, starting states, commands, time step, MuJoCo version and the code of
this package. Calls may come from threads in any order.
"""

import hashlib
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from functools import cache, partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import DamagedFile
from btr_mjx.gap.simulate.batch import Counter
from btr_mjx.gap.simulate.segments import Job, Segments
from btr_mjx.gap.simulate.world import World
from btr_mjx.runs import read_arrays, write_arrays


class Journal(Counter):
    """A counter of simulated steps that stores the simulated states in a folder.

    Attributes:
      steps: simulated steps so far, including those of results read from the folder.
    """

    def __init__(self, folder: Path, report: Callable[[int], None] | None = None, code: bytes = b"") -> None:
        """Open a journal.

        Args:
          folder: of the files; created if absent, emptied if it was written by other code.
          report: called with the number of steps so far after each result.
          code: source of user-defined effects, part of the digest.
        """
        super().__init__()
        self._folder, self._report = folder, report
        self._code = _code() + code
        folder.mkdir(parents=True, exist_ok=True)
        mark = hashlib.sha256(self._code).hexdigest()
        if not (folder / mark).is_file():
            for path in folder.iterdir():
                path.unlink()
            (folder / mark).touch()

    def lookup(self, jobs: Sequence[Job], timestep: float | None) -> list[np.ndarray] | None:
        """Stored states of these jobs; None if there are none or the file is damaged."""
        path = self._file(jobs, timestep)
        if not path.is_file():
            return None
        try:
            saved = read_arrays(path, require_digest=True)
        except DamagedFile:
            return None
        self.add(int(saved["steps"]))
        return [saved[f"states_{i}"] for i in range(len(jobs))]

    def add(self, steps: int) -> None:
        """Add to the number of steps and report it."""
        with self.lock:
            self.steps += steps
            if self._report is not None:
                self._report(self.steps)

    def store(self, jobs: Sequence[Job], timestep: float | None, states: Sequence[np.ndarray], steps: int) -> None:
        """Write the states of these jobs to a file and count their steps."""
        arrays = {f"states_{i}": own for i, own in enumerate(states)} | {"steps": np.array(steps)}
        write_arrays(self._file(jobs, timestep), arrays)
        self.add(steps)

    def close(self) -> None:
        """Remove the files, at the end of a search."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _file(self, jobs: Sequence[Job], timestep: float | None) -> Path:
        return self._folder / f"{_key(self._code, jobs, timestep)}.npz"


def _key(code: bytes, jobs: Sequence[Job], timestep: float | None) -> str:
    """Digest of jobs, time step and code."""
    digest = hashlib.sha256(code)
    digest.update(repr(timestep).encode())
    commands: dict[int, tuple] = {}
    for world, segments in jobs:
        _add_segments(digest, segments)
        _add_world(digest, world)
        for command in commands.setdefault(id(segments.commands), segments.commands):
            changed = world.command(command)
            _add(digest, changed.times, changed.values, changed.delay, changed.added, *changed.lags)
            digest.update(changed.interpolation.encode())
    return digest.hexdigest()


def _add_segments(digest: "hashlib._Hash", segments: Segments) -> None:
    _add(digest, segments.start, segments.qpos, segments.qvel, segments.samples, segments.recording, segments.act)


def _add_world(digest: "hashlib._Hash", world: World) -> None:
    _add(
        digest, _binary(world.model), world.offset, world.wrench, np.array([len(world.laws), len(world.command_edits)])
    )
    for law in world.laws:
        try:
            _add_value(digest, law)
        except RecursionError:  # cyclic reference
            digest.update(os.urandom(16))


def _binary(model: mujoco.MjModel) -> np.ndarray:
    binary = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, binary)
    return binary


def _add_value(digest: "hashlib._Hash", value: Any) -> None:
    """Add a law to the digest, with all values that it holds."""
    digest.update(f"{type(value).__module__}.{type(value).__qualname__}".encode())
    if isinstance(value, (str, bytes, bool, int, float, complex, type(None), Enum)):
        digest.update(repr(value).encode())
    elif isinstance(value, (np.ndarray, np.generic)):
        _add(digest, np.asarray(value))
    elif isinstance(value, mujoco.MjModel):
        _add(digest, _binary(value))
    elif isinstance(value, Mapping):
        _add_value(digest, [part for pair in value.items() for part in pair])
    elif isinstance(value, (list, tuple)):
        digest.update(str(len(value)).encode())
        for part in value:
            _add_value(digest, part)
    elif isinstance(value, (set, frozenset)):
        _add_value(digest, sorted(value, key=repr))
    elif isinstance(value, FunctionType):
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        _add_value(digest, [value.__code__.co_code, value.__defaults__, value.__kwdefaults__, cells])
    elif isinstance(value, MethodType):
        _add_value(digest, [value.__func__, value.__self__])
    elif isinstance(value, partial):
        _add_value(digest, [value.func, value.args, value.keywords])
    elif hasattr(value, "__dict__") and not isinstance(value, type):
        _add_value(digest, vars(value))
    else:
        digest.update(os.urandom(16))  # unknown content: never matches


def _add(digest: "hashlib._Hash", *arrays: np.ndarray | None) -> None:
    for array in arrays:
        digest.update(b"-" if array is None else repr(array.shape).encode())
        if array is not None:
            digest.update(np.ascontiguousarray(array).tobytes())


@cache
def _code() -> bytes:
    """Digest of the code of this package and of the MuJoCo version."""
    digest = hashlib.sha256(mujoco.__version__.encode())
    for path in sorted(Path(__file__).parents[2].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()
