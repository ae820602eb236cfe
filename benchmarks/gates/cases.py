"""Cases of suites: their files, the processes that make and solve them, and their rows."""

import os
import shutil
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Literal

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.runs import note, read_json, write_json
from gates.answers import CODE, data_digest
from gates.rows import NO_ANSWER, Row, row_of


@dataclass(frozen=True)
class Suite:
    """A kind of cases.

    Attributes:
      name: of the suite.
      cases: number of cases, unless another one is asked for.
      seed: of the cases, unless another one is asked for.
      make: from a folder, a seed and the index of a case to its truth; writes the recordings into the folder.
      solve: from the folder to the answer, see `suites.solve`.
      judge: from folder, truth and answer to a row without the names of case and suite.
    """

    name: str
    cases: int
    seed: int
    make: Callable[[Path, int, int], Any]
    solve: Callable[[Path], Mapping[str, Any]]
    judge: Callable[[Path, Mapping[str, Any], Mapping[str, Any]], Row]


@dataclass(frozen=True)
class Case:
    """A case and its files.

    Attributes:
      suite: that it is of.
      seed: of the suite's cases.
      index: of the case.
      out: folder of cases and answers.
      version: folder of answers, which is the digest of the code, or a folder in it.
    """

    suite: Suite
    seed: int
    index: int
    out: Path
    version: str = CODE

    @property
    def name(self) -> str:
        """Name of the case."""
        return f"{self.suite.name}-{self.seed}-{self.index:04d}"

    @property
    def data(self) -> Path:
        """Recordings, all that is read when the case is solved."""
        return self.out / "cases" / self.name / "data"

    @property
    def truth(self) -> Path:
        """What is hidden; written when the recordings are complete."""
        return self.data.with_name("truth.json")

    @property
    def answer(self) -> Path:
        """The answer of a version of the code."""
        return self.out / "answers" / self.version / f"{self.name}.json"

    def make(self) -> None:
        """Write recordings and truth."""
        shutil.rmtree(self.data.parent, ignore_errors=True)
        self.data.mkdir(parents=True)
        write_json(self.truth, self.suite.make(self.data, self.seed, self.index))

    def solve(self) -> None:
        """Write the answer."""
        if not self.version.startswith(CODE):
            raise InputError(f"btr_mjx changed from {self.version} to {CODE} while the run started; start it again")
        write_json(self.answer, dict(self.suite.solve(self.data)) | {"data": data_digest(self.data)})

    def fail(self, why: str) -> None:
        """Keep the reason why there is no answer, as the answer."""
        note(f"{self.name}: {why.strip().splitlines()[-1]}")
        none: dict[str, Any] = {"verdict": NO_ANSWER, "effects": [], "sentence": why, "cpu_seconds": None}
        write_json(self.answer, none | {"data": data_digest(self.data) if self.truth.is_file() else ""})

    def kept(self) -> dict[str, Any] | None:
        """The answer in the cache, where it is one to these recordings; cases that failed keep theirs, too."""
        answer = read_json(self.answer) if self.answer.is_file() else None
        current = not self.truth.is_file() or (answer and answer["data"] == data_digest(self.data))
        return answer if current else None

    def is_solved(self) -> bool:
        """Whether there is an answer; a case that failed is tried again."""
        answer = self.kept()
        return answer is not None and answer["verdict"] != NO_ANSWER

    def row(self, answer: Mapping[str, Any]) -> Row:
        """The row of an answer of any version of the code."""
        if self.truth.is_file():
            row = self.suite.judge(self.data, read_json(self.truth), answer)
        else:
            row = row_of(answer, "a case that was not made", False)
        return replace(row, case=self.name, suite=self.suite.name)


Step = Literal["make", "solve"]


def _end_with_parent() -> None:
    """End this process where the gate was killed: nothing would end a case that hangs."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _work(case: Case, step: Step, core: int | None) -> None:
    """Make or solve a case in this process, on a core of its own: threads of several solvers block each other."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if core is not None:
        os.sched_setaffinity(0, {core})
    mujoco.set_mju_user_warning(lambda _: None)  # hypotheses that diverge are what they are
    try:
        getattr(case, step)()
    except Exception:
        case.fail(traceback.format_exc())


def in_processes(cases: Sequence[Case], step: Step, workers: int, limit: float) -> Iterator[Case]:
    """Make or solve cases in a process each; one that crashes or takes too long has no answer.

    Args:
      cases: what is to be done.
      step: what is done with each.
      workers: number of processes at a time; several get one core each.
      limit: wall-clock time of a process [s].

    Yields:
      The cases, in the order in which they end.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") and workers > 1 else []
    free: list[int | None] = [cores[worker % len(cores)] if cores else None for worker in range(workers)]
    left, running = list(reversed(cases)), dict[SpawnProcess, tuple[Case, int | None, float]]()
    try:
        while left or running:
            while left and free:
                case, core = left.pop(), free.pop()
                process = get_context("spawn").Process(target=_work, args=(case, step, core), daemon=True)
                process.start()
                running[process] = (case, core, time.monotonic() + limit)
            first = min(end for _, _, end in running.values())
            wait([process.sentinel for process in running], max(0.0, first - time.monotonic()))
            for process, (case, core, end) in list(running.items()):
                late = process.is_alive() and time.monotonic() >= end
                if late:
                    process.kill()
                    process.join()
                if process.is_alive():
                    continue
                if late or process.exitcode:
                    case.fail(f"no end within {limit:g} s" if late else f"the process ended with {process.exitcode}")
                del running[process]
                free.append(core)
                yield case
    finally:
        for process in running:
            process.kill()
