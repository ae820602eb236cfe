"""Cores of this machine, divided among the workers of a local cluster."""

import os

from distributed import Worker, WorkerPlugin


class CoreShare(WorkerPlugin):
    """Restricts each worker to its share of the cores before it computes anything."""

    name = "btr-mjx-core-share"

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def setup(self, worker: Worker) -> None:
        """Called by Dask when a worker starts; the threads that it starts later inherit the restriction."""
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, share_of(sorted(os.sched_getaffinity(0)), int(worker.name), self.workers))


def share_of(cores: list[int], index: int, workers: int) -> set[int]:
    """Cores of worker `index` of several: disjoint parts of nearly equal size; one core where there are too few."""
    if workers >= len(cores):
        return {cores[index % len(cores)]}
    return set(cores[index * len(cores) // workers : (index + 1) * len(cores) // workers])
