"""Consecutive slices: adjacent, of the sizes given."""

import numpy as np

from fuzzyarm.common.arithmetic import consecutive


def test_they_divide_an_array_without_gap_or_overlap():
    array = np.arange(9)
    parts = [array[part] for part in consecutive(1, 3, 0, 5)]
    assert [len(part) for part in parts] == [1, 3, 0, 5]
    np.testing.assert_array_equal(np.concatenate(parts), array)


def test_no_sizes_give_no_slices():
    assert consecutive() == []
