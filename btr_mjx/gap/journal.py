"""A journal of what was simulated, so that a search that was killed goes on where it was, to the bit.

A search is deterministic: with the same data it asks for the same simulations, and nearly all of its time goes into
them. So nothing of the search itself is saved. Each answer of `worlds.simulate` is written to a file of its own; a
search that begins again is given these answers instead of simulating.

An answer is only given to the question that it was written for: a file's name is a digest of worlds, starting states,
commands and of this package's code. Threads may ask in any order.
"""

import hashlib
import shutil
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.errors import DamagedFile
from btr_mjx.files import read_arrays, write_arrays
from btr_mjx.gap.stretches import Job, Stretch
from btr_mjx.gap.world import World
from btr_mjx.gap.worlds import Counter


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
    """Digest of what is asked for. The state-dependent laws of worlds are code, which counts as a whole."""
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
    binary = np.empty(mujoco.mj_sizeModel(world.model), np.uint8)
    mujoco.mj_saveModel(world.model, None, binary)
    _add(digest, binary, world.offset, world.wrench, np.array([len(world.laws), len(world.command_edits)]))


def _add(digest: "hashlib._Hash", *arrays: np.ndarray | None) -> None:
    for array in arrays:
        digest.update(b"-" if array is None else repr(array.shape).encode())
        if array is not None:
            digest.update(np.ascontiguousarray(array).tobytes())


@cache
def _code() -> bytes:
    """Digest of the code behind the answers, and of the simulator's version."""
    digest = hashlib.sha256(mujoco.__version__.encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()
