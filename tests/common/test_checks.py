"""Checks return what they were given, or an error that names the argument, the value and what is allowed."""

import datetime
import fractions
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzyarm.common import checks

FINITE = st.floats(allow_nan=False, allow_infinity=False)
NO_NUMBERS = [None, "1", True, np.True_, 1j, [1.0], np.array([1.0]), datetime.date(2020, 1, 1)]


@given(value=FINITE, first=FINITE, last=FINITE)
def test_a_closed_interval_holds_its_ends_and_an_open_one_does_not(value, first, last):
    low, high = sorted((first, last))
    if low <= value <= high:
        assert checks.real("x", value, low=low, high=high) == value
    else:
        with pytest.raises(ValueError, match="out of range"):
            checks.real("x", value, low=low, high=high)
    for bounds in ({"above": value}, {"below": value}):
        with pytest.raises(ValueError, match="out of range"):
            checks.real("x", value, **bounds)


@pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
def test_what_is_no_number_is_a_type_error(value):
    with pytest.raises(TypeError, match=r"duration = .* must be a real number \[s\]; allowed: \(0, inf\) s"):
        checks.real("duration", value, "s", above=0.0)
    with pytest.raises(TypeError, match=r"lanes = .* must be a whole number; allowed: 1, 2, 3"):
        checks.whole("lanes", value, low=1)
    assert not checks.is_real(value)


DAY = datetime.date(2020, 1, 1)


def test_what_is_right_is_returned_in_the_package_s_own_kind():
    for value in (3, np.float32(3.0), np.int8(3), fractions.Fraction(3)):
        found = checks.real("x", value)
        assert type(found) is float and found == 3.0
    for values in ([1, 2.5], np.array([1.0, 2.5])):
        assert checks.reals("point", values, 2, "m") == (1.0, 2.5)
    assert checks.truth("flag", np.False_) is False and checks.instance("day", DAY, datetime.date) is DAY
    assert checks.distinct("policies", ("b", "a")) == ("b", "a") and checks.choice("joints", 2, [1, 2]) == 2
    floats, integers = np.ones(2), np.arange(6, dtype=np.int16).reshape(2, 3)
    assert not np.shares_memory(checks.finite_array("x", floats, (2,)), floats)
    assert checks.finite_array("gain", integers, (2, 3)).dtype == np.float64


def array(values):
    return checks.finite_array("action", values, (2,), "N m")


def point(values):
    return checks.reals("point", values, 2, "m")


CYCLE: list = [1.0]
CYCLE.append(CYCLE)
WRONG = [
    (lambda: checks.real("x", 10**5000), ValueError, "out of range"),
    (lambda: checks.real("x", "x" * 10_000), TypeError, "must be a real number"),
    (lambda: checks.real("x", np.float32("nan")), ValueError, "out of range"),
    (lambda: checks.whole("n", 1.0), TypeError, "n = 1.0 must be a whole number"),
    (lambda: point("12"), TypeError, r"point = '12' must be 2 real numbers \[m\]"),
    (lambda: point({1.0, 2.0}), TypeError, "must be 2 real numbers"),
    (lambda: point((1.0,)), ValueError, "must be 2 real numbers"),
    (lambda: point(np.array(1.0)), ValueError, r"point = array\(1\.\) must be 2 real numbers"),
    (lambda: point(np.ones((2, 1))), ValueError, "must be 2 real numbers"),
    (lambda: point((1.0, None)), TypeError, r"point\[1\] = None must be a real number"),
    (lambda: point((1.0, math.nan)), ValueError, r"point\[1\] = nan m is out of range"),
    (lambda: checks.truth("flag", 1), TypeError, "flag = 1 must be True or False"),
    (lambda: checks.choice("backend", "Ray", ("local", "ray")), ValueError, "is unknown; choose from: local, ray"),
    (lambda: checks.choice("backend", ["ray"], ("local", "ray")), ValueError, "is unknown; choose from: local, ray"),
    (lambda: checks.choice("joints", True, [1, 2]), ValueError, "joints = True"),  # equal to 1, but not meant
    (lambda: checks.instance("day", 3, datetime.date), TypeError, r"day = 3 must be a datetime\.date"),
    (lambda: array([1.0, 2.0, 3.0]), ValueError, r"action has shape \(3,\); allowed: \(2,\)"),
    (lambda: array([1.0, math.inf]), ValueError, "action contains numbers that are not finite"),
    (lambda: array([True, False]), TypeError, r"action must contain real numbers \[N m\], not bool"),
    (lambda: array(["1", "2"]), TypeError, "not <U1"),
    (lambda: array([None, 1.0]), TypeError, "not object"),
    (lambda: checks.distinct("policies", []), ValueError, "^policies = .* must be one or more distinct names$"),
    (lambda: checks.distinct("policies", ("a", "a")), ValueError, "^policies = .* must be one or more distinct"),
    (lambda: checks.array_of("point", [1.0, [2.0]]), ValueError, r"^point = \[1\.0, \[.* is not an array: "),
    (lambda: checks.array_of("point", CYCLE), ValueError, r"^point = \[1\.0, \[.* is not an array: "),
    (lambda: checks.array_of("point", range(10**12)), ValueError, r"^point = range\(0.* is not an array: "),
]


@pytest.mark.parametrize(("call", "error", "message"), WRONG)
def test_what_is_wrong_is_named_in_one_line(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 200


@pytest.mark.parametrize(
    ("bounds", "allowed"),
    [
        ({}, "allowed: (-inf, inf) m"),
        ({"above": 0.0}, "allowed: (0, inf) m"),
        ({"low": 0.0, "high": 1.0}, "allowed: [0, 1] m"),
        ({"low": 0.5, "below": 2.0}, "allowed: [0.5, 2) m"),
        ({"above": 1.0, "low": 0.0, "high": 5.0, "below": 3.0}, "allowed: (1, 3) m"),
    ],
)
def test_the_message_shows_the_interval_as_it_is_written(bounds, allowed):
    with pytest.raises(ValueError) as caught:
        checks.real("radius", math.nan, "m", **bounds)
    assert str(caught.value) == f"radius = nan m is out of range; {allowed}"


@given(value=st.integers(-50, 50), low=st.integers(-20, 20), high=st.one_of(st.none(), st.integers(-20, 20)))
def test_whole_numbers_have_bounds_too(value, low, high):
    if value >= low and (high is None or value <= high):
        found = checks.whole("n", np.int64(value), low=low, high=high)
        assert type(found) is int and found == value
    else:
        with pytest.raises(ValueError, match=rf"n = {value} is out of range; allowed: {low}( to {high}|, )"):
            checks.whole("n", value, low=low, high=high)


@given(first=st.floats(-10.0, 10.0), last=st.floats(-10.0, 10.0))
def test_an_interval_is_ordered_and_within_its_bounds(first, last):
    if -5.0 <= first <= last <= 5.0:
        assert checks.interval("mass", (first, last), low=-5.0, high=5.0) == (first, last)
    else:
        with pytest.raises(ValueError, match=r"mass(\[[01]\])? = "):
            checks.interval("mass", (first, last), low=-5.0, high=5.0)
