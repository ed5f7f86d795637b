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
NO_NUMBERS = [None, "1", b"1", True, np.True_, 1j, np.complex128(1), [1.0], np.array([1.0]), datetime.date(2020, 1, 1)]


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


@pytest.mark.parametrize("value", [3, np.float32(3.0), np.int8(3), fractions.Fraction(3)])
def test_every_real_number_becomes_a_float(value):
    found = checks.real("x", value)
    assert type(found) is float and found == 3.0


@pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
def test_what_is_no_number_is_a_type_error(value):
    with pytest.raises(TypeError, match=r"duration = .* must be a real number \[s\]; allowed: \(0, inf\) s"):
        checks.real("duration", value, "s", above=0.0)
    with pytest.raises(TypeError, match=r"lanes = .* must be a whole number; allowed: 1, 2, 3"):
        checks.whole("lanes", value, low=1)
    assert not checks.is_real(value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400, np.float32("nan")])
def test_what_is_not_finite_is_out_of_every_range(value):
    with pytest.raises(ValueError, match="out of range"):
        checks.real("x", value)


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


def test_a_message_is_one_short_line_whatever_the_value():
    for value in ("x" * 10_000, 10**5000, [0.0] * 999, np.eye(2)):
        with pytest.raises((TypeError, ValueError)) as caught:
            checks.real("x", value)
        assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)


@given(value=st.integers(-50, 50), low=st.integers(-20, 20), high=st.one_of(st.none(), st.integers(-20, 20)))
def test_whole_numbers_have_bounds_too(value, low, high):
    if value >= low and (high is None or value <= high):
        found = checks.whole("n", np.int64(value), low=low, high=high)
        assert type(found) is int and found == value
    else:
        with pytest.raises(ValueError, match=rf"n = {value} is out of range; allowed: {low}( to {high}|, )"):
            checks.whole("n", value, low=low, high=high)


@pytest.mark.parametrize("value", [1.0, "1", np.float64(1.0), True])
def test_a_float_is_no_whole_number(value):
    with pytest.raises(TypeError, match="whole number"):
        checks.whole("n", value)


@pytest.mark.parametrize("values", [(1, 2.5), [1, 2.5], np.array([1.0, 2.5])])
def test_several_numbers_are_a_tuple_of_floats(values):
    assert checks.reals("point", values, 2, "m") == (1.0, 2.5)


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ("12", TypeError, r"point = '12' must be 2 real numbers \[m\]"),
        (1.0, TypeError, "must be 2 real numbers"),
        ({1.0, 2.0}, TypeError, "must be 2 real numbers"),
        ((1.0,), ValueError, "must be 2 real numbers"),
        ([[1.0, 2.0]], ValueError, "must be 2 real numbers"),
        (np.array(1.0), ValueError, r"point = array\(1\.\) must be 2 real numbers"),
        (memoryview(np.array(1.0)), ValueError, "must be 2 real numbers"),
        (np.ones((2, 1)), ValueError, "must be 2 real numbers"),
        ((1.0, None), TypeError, r"point\[1\] = None must be a real number"),
        ((1.0, math.nan), ValueError, r"point\[1\] = nan m is out of range"),
    ],
)
def test_wrong_sequences_are_named_with_the_entry(values, error, message):
    with pytest.raises(error, match=message):
        checks.reals("point", values, 2, "m")


@given(first=st.floats(-10.0, 10.0), last=st.floats(-10.0, 10.0))
def test_an_interval_is_ordered_and_within_its_bounds(first, last):
    if -5.0 <= first <= last <= 5.0:
        assert checks.interval("mass", (first, last), low=-5.0, high=5.0) == (first, last)
    else:
        with pytest.raises(ValueError, match=r"mass(\[[01]\])? = "):
            checks.interval("mass", (first, last), low=-5.0, high=5.0)


def test_truth_is_a_boolean_and_no_number():
    assert checks.truth("flag", True) is True and checks.truth("flag", np.False_) is False
    for value in (0, 1, "yes", None):
        with pytest.raises(TypeError, match=r"flag = .* must be True or False"):
            checks.truth("flag", value)


def test_a_choice_is_one_of_its_kind():
    assert checks.choice("backend", "ray", ("local", "ray")) == "ray"
    assert checks.choice("joints", 2, [1, 2]) == 2
    for value in ("Ray", "", None, ["ray"]):
        with pytest.raises(ValueError, match=r"backend = .* is unknown; choose from: local, ray"):
            checks.choice("backend", value, ("local", "ray"))
    with pytest.raises(ValueError, match="joints = True"):  # equal to 1, but not meant
        checks.choice("joints", True, [1, 2])


def test_an_instance_is_of_the_class():
    day = datetime.date(2020, 1, 1)
    assert checks.instance("day", day, datetime.date) is day
    with pytest.raises(TypeError, match=r"day = 3 must be a datetime\.date"):
        checks.instance("day", 3, datetime.date)


def test_an_array_is_a_new_one_of_floats():
    given_array = np.arange(6, dtype=np.int16).reshape(2, 3)
    found = checks.finite_array("gain", given_array, (2, 3))
    assert found.dtype == np.float64 and np.array_equal(found, given_array)
    floats = np.ones(2)
    assert not np.shares_memory(checks.finite_array("x", floats, (2,)), floats)


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ([1.0, 2.0, 3.0], ValueError, r"action has shape \(3,\); allowed: \(2,\)"),
        ([1.0, math.inf], ValueError, "action holds numbers that are not finite"),
        ([True, False], TypeError, r"action must hold real numbers \[N m\]; it holds bool"),
        ([1j, 0], TypeError, "it holds complex128"),
        (["1", "2"], TypeError, "it holds <U1"),
        ([None, 1.0], TypeError, "it holds object"),
        (np.array(["2020", "2021"], dtype="M8[Y]"), TypeError, "it holds datetime64"),
    ],
)
def test_other_arrays_are_refused(values, error, message):
    with pytest.raises(error, match=message):
        checks.finite_array("action", values, (2,), "N m")


@pytest.mark.parametrize("wrong", [[], ("a", "a"), ("a", "b", "a")])
def test_names_that_are_not_distinct_are_refused(wrong):
    with pytest.raises(ValueError, match=r"^policies = .* must be one or more different names$"):
        checks.distinct("policies", wrong)
    assert checks.distinct("policies", ("b", "a")) == ("b", "a")


CYCLE: list = [1.0]
CYCLE.append(CYCLE)


@pytest.mark.parametrize("values", [[1.0, [2.0]], CYCLE, range(10**12)], ids=["uneven", "cycle", "endless"])
def test_what_no_array_holds_is_named(values):
    with pytest.raises(ValueError, match=r"^point = (\[1\.0, \[|range\(0).* is no array: ") as caught:
        checks.array_of("point", values)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300
