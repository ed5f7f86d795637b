"""Numbers that state a bound never state a tighter one."""

import doctest
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzyarm.common import arithmetic
from fuzzyarm.common.arithmetic import at_least, at_most

FINITE = st.floats(allow_nan=False, allow_infinity=False)


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
    with pytest.raises(ValueError, match="no bound"):
        at_most(value, 3)


def test_examples():
    assert doctest.testmod(arithmetic).failed == 0
