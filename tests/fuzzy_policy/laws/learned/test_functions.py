"""tanh, the logistic function and asinh of learned policies, against numbers of more digits, and their symmetries."""

import numpy as np
import pytest

from fuzzyarm.fuzzy_policy.laws.learned.network import _LARGEST, add_product, area_sine, hyperbolic_tangent
from fuzzyarm.numbers.functions import Cells
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

RANDOM = np.random.default_rng(0)


def many(function, numbers):
    return np.array([function(float(number)) for number in numbers])


@pytest.mark.parametrize(
    ("function", "exact", "largest", "error"),
    [(hyperbolic_tangent, np.tanh, 2.0, 2e-15), (area_sine, np.arcsinh, 18.0, 1e-15)],
)
def test_the_functions_are_as_exact_as_they_say(function, exact, largest, error):
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("no number type with more digits on this machine")
    sizes = 10.0 ** np.concatenate([RANDOM.uniform(-12.0, 2.0, 300), RANDOM.uniform(0.0, largest, 300)])
    wanted = exact(sizes.astype(np.longdouble))
    assert np.abs((many(function, sizes) - wanted) / wanted).max() < error
    np.testing.assert_array_equal(many(function, -sizes), -many(function, sizes))
    assert function(0.0) == 0.0 and np.isnan(function(np.nan)) and function(np.inf) == function(_LARGEST)


@pytest.mark.parametrize("columns", [1, 4, 5, 12, 63])
def test_products_on_the_machine_have_the_same_bits(columns):
    transposed, x, start = RANDOM.normal(size=(columns, 7)), RANDOM.normal(size=columns), RANDOM.normal(size=7)
    plain, found = start.copy(), start.copy()[np.newaxis]

    def product(x, y, _, transposed):
        add_product(x, transposed, y)
        return x, y

    add_product(x, transposed, plain)
    kernel = Kernel(Program(product, (Cells((columns,)), Cells((7,))), (), [transposed.shape]))
    kernel((x[np.newaxis].copy(), found), np.empty(0), (transposed,))
    np.testing.assert_array_equal(found[0], plain)
    np.testing.assert_allclose(plain, start + x @ transposed, rtol=1e-13)
