"""Independent tasks in threads: the linear algebra of one task overlaps with the simulations of another."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from btr_mjx.runs import available_cores


def run_in_threads[T](tasks: Sequence[Callable[[], T]], most: int | None = None) -> list[T]:
    """Run independent tasks in threads.

    Args:
      tasks: functions without arguments; results must not depend on the order of execution.
      most: largest number of threads; None for the number of cores.

    Returns:
      Results in the order of the tasks.

    Raises:
      Exception: that of the first failed task in this order, after running tasks have ended; waiting tasks are
        cancelled.
    """
    threads = min(len(tasks), most or available_cores())
    if threads < 2:
        return [task() for task in tasks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda task: task(), tasks))
