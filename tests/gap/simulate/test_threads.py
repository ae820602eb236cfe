"""Independent tasks in threads: order of results, concurrency, exceptions."""

import threading
import time
from functools import partial

import pytest

from btr_mjx.gap.simulate import run_in_threads


def test_results_are_in_the_order_of_the_tasks() -> None:
    """The first task ends last."""
    ended = []

    def task(i: int) -> int:
        time.sleep(0.03 * (3 - i))
        ended.append(i)
        return i * i

    assert run_in_threads([partial(task, i) for i in range(4)], most=4) == [0, 1, 4, 9]
    assert ended == [3, 2, 1, 0]
    assert run_in_threads([]) == []


def test_tasks_run_at_the_same_time() -> None:
    """Each waits for the other, which would deadlock in sequence."""
    both = threading.Barrier(2, timeout=10)
    assert sorted(run_in_threads([both.wait, both.wait], most=2)) == [0, 1]


def test_one_thread_runs_in_the_caller() -> None:
    assert set(run_in_threads([threading.get_ident] * 3, most=1)) == {threading.get_ident()}


def test_exception_is_raised_and_cancels_the_rest() -> None:
    begun = []

    def fails() -> None:
        begun.append("fails")
        raise ValueError("as it was")

    def later(i: int) -> None:
        begun.append(i)
        time.sleep(0.05)

    with pytest.raises(ValueError, match="as it was"):
        run_in_threads([fails, *(partial(later, i) for i in range(20))], most=2)
    assert len(begun) < 10
