"""The bisection ends at the threshold, from either side, with no more evaluations than needed."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzyarm.common.arithmetic import last_that_works

POSITIVE = st.floats(1e-6, 1e6)


@given(good=POSITIVE, factor=st.floats(1.01, 1e3), place=st.floats(0.001, 0.999), resolution=st.floats(1e-9, 0.5))
def test_it_is_within_the_resolution_of_the_threshold(good, factor, place, resolution):
    threshold = good * factor**place
    found = last_that_works(lambda x: x <= threshold, good, good * factor, resolution=resolution)
    assert good <= found <= threshold <= found * (1.0 + resolution) * (1.0 + 1e-12)
    threshold = good / factor**place  # downwards
    found = last_that_works(lambda x: x >= threshold, good, good / factor, resolution=resolution)
    assert threshold <= found <= good and found <= threshold * (1.0 + resolution) * (1.0 + 1e-12)


@pytest.mark.parametrize("factor", [1.5, 2.0, 10.0])
@pytest.mark.parametrize("direction", [1, -1])
def test_with_a_limit_it_looks_for_the_end_first(factor, direction):
    ratio, threshold = factor**direction, 123.4**direction

    def works(x):
        return (x - threshold) * direction <= 0.0

    found = last_that_works(works, 1.0, ratio, resolution=1e-4, limit=1e6**direction)
    assert works(found) and found == pytest.approx(threshold, rel=1e-4)


def test_what_always_works_has_no_end():
    asked = []
    assert last_that_works(lambda x: asked.append(x) or True, 1.0, 2.0, resolution=0.1, limit=1000.0) is None
    assert asked == [2.0**k for k in range(1, 10)]  # the last number tried is the last one at or below the limit


def test_a_number_that_works_is_never_asked_again():
    asked = []
    found = last_that_works(lambda x: asked.append(x) or x < 3.0, 1.0, 16.0, resolution=1e-3)
    assert 1.0 not in asked and 16.0 not in asked and len(set(asked)) == len(asked)
    assert len(asked) <= math.ceil(math.log2(math.log(16.0) / math.log(1.001))) + 1
    assert found in asked
