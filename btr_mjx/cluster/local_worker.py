"""Workers on this machine: each owns its share of the cores."""

import os
import signal

from distributed import Worker, WorkerPlugin


class LocalWorker(WorkerPlugin):
    """Restricts each worker to its share of the cores before it computes anything."""

    name = "btr-mjx-local-worker"

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def setup(self, worker: Worker) -> None:
        """Called by Dask when a worker starts; the threads that it starts later inherit the restriction."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches workers, too, which the client stops
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, share_of(sorted(os.sched_getaffinity(0)), int(worker.name), self.workers))


def share_of(cores: list[int], index: int, workers: int) -> set[int]:
    """Cores of worker `index` of several: disjoint parts of nearly equal size; one core where there are too few."""
    if workers >= len(cores):
        return {cores[index % len(cores)]}
    return set(cores[index * len(cores) // workers : (index + 1) * len(cores) // workers])
