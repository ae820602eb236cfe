"""A journal of what was simulated, so that a search that was killed goes on where it was, to the bit.

A search is deterministic: with the same data it asks for the same simulations, and nearly all of its time goes into
them. So nothing of the search itself is saved. Each answer of `batch.simulate` is written to a file of its own; a
search that begins again is given these answers instead of simulating.

An answer is only given to the question that it was written for: a file's name is a digest of worlds, starting states,
commands and of this package's code. Threads may ask in any order.
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
from btr_mjx.gap.simulate.stretches import Job, Stretch
from btr_mjx.gap.simulate.world import World
from btr_mjx.runs import read_arrays, write_arrays


class Journal(Counter):
    """Counts simulated steps, and keeps what was simulated in a folder.

    Attributes:
      steps: simulated steps so far, those that were read back included.
    """

    def __init__(self, folder: Path, report: Callable[[int], None] | None = None, code: bytes = b"") -> None:
        """Open a journal.

        Args:
          folder: of the files; made if absent.
          report: called with the number of steps so far after each answer.
          code: of effects that are not this package's; answers found with other code are not given.
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

    def recall(self, jobs: Sequence[Job], timestep: float | None) -> list[np.ndarray] | None:
        """The states that were simulated for this question; None where there are none."""
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
        """Count steps, and tell of it."""
        with self.lock:
            self.steps += steps
            if self._report is not None:
                self._report(self.steps)

    def keep(self, jobs: Sequence[Job], timestep: float | None, states: Sequence[np.ndarray], steps: int) -> None:
        """Write the states of this question."""
        arrays = {f"states_{i}": own for i, own in enumerate(states)} | {"steps": np.array(steps)}
        write_arrays(self._file(jobs, timestep), arrays)
        self.add(steps)

    def close(self) -> None:
        """Remove the files: the search has come to its end."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _file(self, jobs: Sequence[Job], timestep: float | None) -> Path:
        return self._folder / f"{_question(self._code, jobs, timestep)}.npz"


def _question(code: bytes, jobs: Sequence[Job], timestep: float | None) -> str:
    """Digest of what is asked for."""
    digest = hashlib.sha256(code)
    digest.update(repr(timestep).encode())
    commands: dict[int, tuple] = {}
    for world, stretch in jobs:
        _add_stretch(digest, stretch)
        _add_world(digest, world)
        for command in commands.setdefault(id(stretch.commands), stretch.commands):
            changed = world.command(command)
            _add(digest, changed.times, changed.values, changed.delay, changed.added, *changed.lags)
            digest.update(changed.interpolation.encode())
    return digest.hexdigest()


def _add_stretch(digest: "hashlib._Hash", stretch: Stretch) -> None:
    _add(digest, stretch.start, stretch.qpos, stretch.qvel, stretch.samples, stretch.recording, stretch.act)


def _add_world(digest: "hashlib._Hash", world: World) -> None:
    _add(
        digest, _binary(world.model), world.offset, world.wrench, np.array([len(world.laws), len(world.command_edits)])
    )
    for law in world.laws:
        try:
            _add_value(digest, law)
        except RecursionError:  # it holds itself
            digest.update(os.urandom(16))


def _binary(model: mujoco.MjModel) -> np.ndarray:
    binary = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, binary)
    return binary


def _add_value(digest: "hashlib._Hash", value: Any) -> None:
    """Add a law, with all the numbers that it holds: one of another size is another question."""
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
        digest.update(os.urandom(16))  # nobody knows what it holds: a question that is never answered twice


def _add(digest: "hashlib._Hash", *arrays: np.ndarray | None) -> None:
    for array in arrays:
        digest.update(b"-" if array is None else repr(array.shape).encode())
        if array is not None:
            digest.update(np.ascontiguousarray(array).tobytes())


@cache
def _code() -> bytes:
    """Digest of this package's code, which is behind the answers, and of the simulator's version."""
    digest = hashlib.sha256(mujoco.__version__.encode())
    for path in sorted(Path(__file__).parents[2].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()
