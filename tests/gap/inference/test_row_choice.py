"""Rows chosen of several arrays, against a loop over rows."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.gap.windows import select_rows


@given(st.lists(st.integers(0, 3), min_size=1, max_size=9), st.booleans())
def test_every_row_is_of_the_array_that_it_is_chosen_of(chosen: list[int], shared: bool) -> None:
    arrays = [100.0 * i + np.arange(2.0 * len(chosen)).reshape(-1, 2) for i in range(4)]
    if shared:
        arrays[2] = arrays[0]
    before = [array.copy() for array in arrays]
    found = select_rows(arrays[0], arrays[1:], np.array(chosen))
    np.testing.assert_array_equal(found, np.array([before[i][row] for row, i in enumerate(chosen)]))
    for array, kept in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, kept)


def test_rows_of_one_array_are_that_array() -> None:
    arrays = [np.zeros((3, 2)), np.ones((3, 2))]
    assert select_rows(arrays[0], arrays[1:], np.array([1, 1, 1])) is arrays[1]
    assert select_rows(arrays[0], [arrays[0], arrays[1]], np.array([0, 1, 0])) is arrays[0]
