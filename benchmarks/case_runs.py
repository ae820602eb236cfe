"""Runs blind cases: one process makes a case, another one solves it, on this machine or on a cluster."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from btr_mjx.cluster import map_cases
from btr_mjx.runs import note, write_json


@dataclass(frozen=True)
class Files:
    """Paths of the files of a case."""

    folder: Path
    index: int

    @property
    def name(self) -> str:
        """Name of the case."""
        return f"{self.index:04d}"

    @property
    def truth(self) -> Path:
        """Truth, written by the process that makes the case."""
        return self.folder / "truth" / f"{self.name}.json"

    @property
    def answer(self) -> Path:
        """Answer, written by the process that solves the case."""
        return self.folder / "answers" / f"{self.name}.json"

    @property
    def oracle(self) -> Path:
        """Detectability of the truth, written after the answer."""
        return self.folder / "oracle" / f"{self.name}.json"

    @property
    def data(self) -> Path:
        """Dataset, the only input of the solver; removed when the case is done, as its seed gives it again."""
        return self.folder / "data" / self.name


def pin_to_cores(cores: Any) -> None:
    """Restrict a solver to its own cores: threads of several solvers would block each other at every step.

    Args:
      cores: queue with a set of core numbers for each solver.
    """
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores.get())


def scheduled[F: Files](
    left: Sequence[F], make: Callable[[F], None], work: Callable[[F], None], workers: int, failed: Path
) -> Iterator[int]:
    """Make cases and solve them in processes of their own; yields the index of each case when it is solved.

    Args:
      left: files of the cases. A case whose truth and data exist is not made again.
      make: function that makes a case.
      work: function that solves a case.
      workers: number of processes that make cases, and of those that solve them; several solvers get one core each.
      failed: folder for the errors of cases that fail, which are not yielded.

    Yields:
      Indices of solved cases, in the order in which they end.
    """
    context = multiprocessing.get_context("spawn")
    cores = context.Queue()
    usable = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    for worker in range(workers):
        cores.put({usable[worker % len(usable)]} if workers > 1 else set(usable))
    with (
        ProcessPoolExecutor(workers, context, pin_to_cores, (cores,)) as solvers,
        ProcessPoolExecutor(workers, context) as separate_makers,
    ):
        # With one worker, the times of cases are measured: no other case is made meanwhile.
        makers = separate_makers if workers > 1 else solvers
        pending: dict[Future[None], tuple[str, F]] = {}
        queue = iter(left)

        def feed() -> None:
            files = next(queue, None)
            if files is not None:
                ready = files.truth.is_file() and files.data.is_dir()
                task = solvers.submit(work, files) if ready else makers.submit(make, files)
                pending[task] = ("solved" if ready else "made", files)

        for _ in range(2 * workers):
            feed()
        while pending:
            done, _ = wait(pending, return_when=FIRST_COMPLETED)
            for task in done:
                stage, files = pending.pop(task)
                failure = task.exception()
                if failure is not None:
                    report_failure(files, f"{type(failure).__name__}: {failure}", failed)
                    feed()
                elif stage == "made":
                    pending[solvers.submit(work, files)] = ("solved", files)
                else:
                    yield files.index
                    feed()


def on_cluster[F: Files](
    left: Sequence[F], make: Callable[[F], None], work: Callable[[F], None], cluster: str, failed: Path
) -> Iterator[int]:
    """The same as `scheduled` on a cluster: one task makes a case, then solves it from its data alone."""
    for files, failure in map_cases(partial(make_and_work, make, work), left, cluster):
        if failure:
            report_failure(files, failure, failed)
        else:
            yield files.index


def make_and_work[F: Files](make: Callable[[F], None], work: Callable[[F], None], files: F) -> str:
    """Make a case, unless that was done, and solve it; returns its error, which must not stop the other cases."""
    try:
        if not (files.truth.is_file() and files.data.is_dir()):
            make(files)
        work(files)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def report_failure(files: Files, failure: str, failed: Path) -> None:
    """Print and keep the error of a case."""
    note(f"case {files.name} failed: {failure}")
    write_json(failed / f"{files.name}.json", {"error": failure})
