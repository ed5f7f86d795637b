"""tanh, the logistic function and asinh of learned policies, against numbers of more digits, and their symmetries."""

import numpy as np
import pytest

from fuzzyarm.fuzzy_policy.laws.learned.network import LARGEST, add_product, area_sine, hyperbolic_tangent, logistic
from fuzzyarm.numbers.functions import Cells
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

RANDOM = np.random.default_rng(0)
SIZES = 10.0 ** RANDOM.uniform(-12.0, 2.0, 300)


def many(function, numbers):
    return np.array([function(float(number)) for number in numbers])


@pytest.mark.parametrize(
    ("function", "exact", "sizes", "error"),
    [
        (hyperbolic_tangent, np.tanh, SIZES, 2e-15),
        (area_sine, np.arcsinh, SIZES, 1e-15),
        (area_sine, np.arcsinh, 10.0 ** RANDOM.uniform(0.0, 18.0, 300), 1e-15),
    ],
)
def test_the_functions_are_as_exact_as_they_say(function, exact, sizes, error):
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("no number type with more digits on this machine")
    wanted = exact(sizes.astype(np.longdouble))
    assert np.abs((many(function, sizes) - wanted) / wanted).max() < error
    np.testing.assert_array_equal(many(function, -sizes), -many(function, sizes))


def test_the_logistic_function_is_its_definition():
    numbers = np.concatenate([-SIZES, SIZES])
    with np.errstate(over="ignore"):
        np.testing.assert_allclose(many(logistic, numbers), 1.0 / (1.0 + np.exp(-numbers)), rtol=0.0, atol=1e-15)


def test_zero_stays_zero_and_what_is_no_number_stays_none():
    """ρ = 0 for z = 0 and h = 0 of a learned observer follows from the first."""
    for function in (hyperbolic_tangent, area_sine):
        assert function(0.0) == 0.0
        assert np.isnan(function(np.nan))
    assert hyperbolic_tangent(-np.inf) == -1.0 and hyperbolic_tangent(1e300) == 1.0
    assert area_sine(np.inf) == area_sine(LARGEST)


@pytest.mark.parametrize("columns", [1, 4, 5, 12, 63])
def test_products_on_the_machine_have_the_same_bits(columns):
    transposed, x = RANDOM.normal(size=(columns, 7)), RANDOM.normal(size=columns)
    start = RANDOM.normal(size=7)
    plain, found = start.copy(), start.copy()[np.newaxis]

    def product(x, y, _, transposed):
        add_product(x, transposed, y)
        return x, y

    add_product(x, transposed, plain)
    Kernel(Program(product, (Cells((columns,)), Cells((7,))), (), [transposed.shape]))(
        (x[np.newaxis].copy(), found), np.empty(0), (transposed,)
    )
    np.testing.assert_array_equal(found[0], plain)
    np.testing.assert_allclose(plain, start + x @ transposed, rtol=1e-13)
