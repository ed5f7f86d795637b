"""Numbers that state a bound never state a tighter one; the bisection ends at the threshold, from either side."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzyarm.common.arithmetic import at_least, at_most, last_that_works

FINITE = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(1e-6, 1e6)


@given(FINITE, st.integers(1, 17))
def test_the_text_lies_on_the_safe_side_and_close(value, digits):
    exact, low, high = Fraction(repr(value)), Fraction(at_least(value, digits)), Fraction(at_most(value, digits))
    assert low <= exact <= high
    assert high - low <= abs(exact) * Fraction(10) ** (1 - digits) * 2


@given(st.integers(-999, 999), st.integers(-8, 8))
def test_a_number_of_few_digits_is_itself(mantissa, exponent):
    value = float(f"{mantissa}e{exponent}")
    number = Fraction(mantissa) * Fraction(10) ** exponent
    assert Fraction(at_most(value, 3)) == Fraction(at_least(value, 3)) == number


@pytest.mark.parametrize("value", [float("inf"), float("-inf"), float("nan")])
def test_what_is_not_finite_is_no_bound(value):
    with pytest.raises(ValueError, match="cannot state a bound"):
        at_most(value, 3)


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
