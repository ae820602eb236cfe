"""Independent parts of a search side by side: while one simulates, another does its linear algebra.

A batch of simulations keeps all cores busy, what lies between two batches keeps one. What is asked of both sides of the
split, or of several candidates, has nothing to wait for.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from btr_mjx.runs import available_cores


def abreast[T](tasks: Sequence[Callable[[], T]], most: int | None = None) -> list[T]:
    """Run tasks that do not depend on each other in threads.

    Args:
      tasks: each without arguments. Results must not depend on their order.
      most: threads; None for as many as there are cores.

    Returns:
      What they return, in their order.

    Raises:
      Exception: what the first of them raised, after those that were running have ended.
    """
    threads = min(len(tasks), most or available_cores())
    if threads < 2:
        return [task() for task in tasks]
    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(task) for task in tasks]
        try:
            return [future.result() for future in futures]
        except BaseException:
            for future in futures:
                future.cancel()
            raise
