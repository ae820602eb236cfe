"""Cache of simulated states on disk, so that an interrupted search resumes with bit-identical results.

A search is deterministic and spends nearly all of its time in simulations. Its own state is therefore not saved: the
numbers of each fit, and each result of `batch.simulate` beside fits, are written to files, and a restarted search reads
these instead of simulating.

The file name is a SHA-256 digest of the worlds, starting states, commands, time step, MuJoCo version and the code of
this package. Calls may come from threads in any order.
"""

import hashlib
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import DamagedFile
from btr_mjx.gap.simulate.batch import Counter
from btr_mjx.gap.simulate.segments import Job
from btr_mjx.runs import content_digest, read_arrays, write_arrays


class Journal(Counter):
    """A counter of simulated steps that stores the simulated states in a folder.

    Attributes:
      steps: simulated steps so far, including those of results read from the folder.
    """

    def __init__(
        self,
        folder: Path,
        report: Callable[[int], None] | None = None,
        code: bytes = b"",
        expect: Callable[[float], None] | None = None,
    ) -> None:
        """Open a journal.

        Args:
          folder: of the files; created if absent, emptied if it was written by other code.
          report: called with the number of steps so far after each result.
          code: source of user-defined effects, part of the digest.
          expect: called with the number of steps that the phase of the search which has begun takes, about.
        """
        super().__init__()
        self._folder, self._report, self._expect = folder, report, expect
        self._within = False
        self._code, self._begun = _code() + code, time.time()
        folder.mkdir(parents=True, exist_ok=True)
        mark = hashlib.sha256(self._code).hexdigest()
        if not (folder / mark).is_file():
            for path in folder.iterdir():
                path.unlink()
            (folder / mark).touch()

    def lookup(self, jobs: Sequence[Job], timestep: float | None) -> tuple[list[np.ndarray] | None, Path | None]:
        """Stored states of these jobs, None if there are none or the file is damaged; and their file.

        There is no file for what is simulated within `remembered`.
        """
        if self._within:
            return None, None
        path = self._folder / f"{_key(self._code, jobs, timestep)}.npz"
        saved = self._read(path)
        return None if saved is None else [saved[f"states_{i}"] for i in range(len(jobs))], path

    def remembered(
        self, parts: tuple[Any, ...], compute: Callable[[], Mapping[str, np.ndarray]]
    ) -> Mapping[str, np.ndarray]:
        """Arrays that are computed from `parts`, or were before and are read.

        What is simulated for them is not stored: it is simulated again where the computation did not end. Not for
        threads.

        Args:
          parts: all that the arrays depend on, besides code.
          compute: computes them, with steps that this journal counts.
        """
        if self._within:
            return compute()
        path = self._folder / f"{_digest([self._code, *parts])}.npz"
        if (saved := self._read(path)) is not None:
            return saved
        self._within, begun = True, self.steps
        try:
            found = compute()
        finally:
            self._within = False
        self._write(path, found, self.steps - begun)
        return found

    def add(self, steps: int) -> None:
        """Add to the number of steps and report it."""
        with self.lock:
            self.steps += steps
            if self._report is not None:
                self._report(self.steps)

    def expect(self, steps: float) -> None:
        """Tell how many steps the phase that has begun takes, about."""
        if self._expect is not None:
            self._expect(steps)

    def store(self, path: Path | None, states: Sequence[np.ndarray], steps: int) -> None:
        """Write the states of jobs, which took these steps, to their file, if they have one."""
        if path is not None:
            self._write(path, {f"states_{i}": own for i, own in enumerate(states)}, steps)

    def _read(self, path: Path) -> dict[str, np.ndarray] | None:
        """What a file holds, counted; None where there is none, or a damaged one."""
        if not path.is_file():
            return None
        try:
            saved = read_arrays(path, require_digest=True)
        except DamagedFile:
            return None
        self.add(int(saved["steps"]))
        if saved["begun"] != self._begun:
            self.earlier = max(self.earlier, float(saved["seconds"]))
        return saved

    def _write(self, path: Path, arrays: Mapping[str, np.ndarray], steps: int) -> None:
        seconds = time.time() - self._begun + self.earlier
        write_arrays(path, {**arrays, "steps": steps, "seconds": seconds, "begun": self._begun})

    def close(self) -> None:
        """Remove the files, at the end of a search."""
        shutil.rmtree(self._folder, ignore_errors=True)


def _key(code: bytes, jobs: Sequence[Job], timestep: float | None) -> str:
    """Digest of jobs, time step and code."""
    parts: list[Any] = [code, timestep]
    for world, segments in jobs:
        parts += [segments.start, segments.qpos, segments.qvel, segments.samples, segments.recording, segments.act]
        parts += [world.model, world.offset, world.wrench, len(world.laws), len(world.command_edits)]
        for function in (*world.laws, *world.command_edits):
            parts.append(_digest(function))
        parts += [segments.commands[recording] for recording in np.unique(segments.recording).tolist()]
    return content_digest(parts)


def _digest(value: Any) -> str:
    """Digest of a value; one that never matches where its content is not known."""
    try:
        return content_digest(value, unknown=_random)
    except RecursionError:  # a law that holds itself
        return os.urandom(16).hex()


def _random(value: Any) -> bytes:
    """Never matches: the content of the value is not known."""
    return os.urandom(16)


@cache
def _code() -> bytes:
    """Digest of the code of this package and of the MuJoCo version."""
    digest = hashlib.sha256(mujoco.__version__.encode())
    for path in sorted(Path(__file__).parents[2].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()
