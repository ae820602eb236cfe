"""Independent parts side by side: answers in their order, errors as they were raised."""

import threading
import time
from functools import partial

import pytest

from btr_mjx.gap.simulate import abreast


def test_answers_come_in_the_order_of_the_tasks() -> None:
    """Though the first one ends last."""
    ended = []

    def task(i: int) -> int:
        time.sleep(0.03 * (3 - i))
        ended.append(i)
        return i * i

    assert abreast([partial(task, i) for i in range(4)], most=4) == [0, 1, 4, 9]
    assert ended == [3, 2, 1, 0]
    assert abreast([]) == []


def test_tasks_run_at_the_same_time() -> None:
    """Each waits for the other, which would never end one after another."""
    both = threading.Barrier(2, timeout=10)
    assert sorted(abreast([both.wait, both.wait], most=2)) == [0, 1]


def test_one_core_needs_no_threads() -> None:
    assert set(abreast([threading.get_ident] * 3, most=1)) == {threading.get_ident()}


def test_an_error_comes_through_and_ends_the_rest() -> None:
    begun = []

    def fails() -> None:
        begun.append("fails")
        raise ValueError("as it was")

    def later(i: int) -> None:
        begun.append(i)
        time.sleep(0.05)

    with pytest.raises(ValueError, match="as it was"):
        abreast([fails, *(partial(later, i) for i in range(20))], most=2)
    assert len(begun) < 10
