"""Numbers among which some are known beforehand: exact in every kind of number, and nothing is computed in vain."""

import numpy as np
import pytest

from fuzzyarm.envs.physics._recursion import Folded, unfolded
from fuzzyarm.numbers.program import Program

KNOWN = (0.0, 1.0, -1.0, 2.5)
EXPRESSIONS = (
    lambda x, y, k: x + y - k,
    lambda x, y, k: k - (x - y),
    lambda x, y, k: -x * y + k * x,
    lambda x, y, k: -(x * k) - -y,
    lambda x, y, k: (x - k) * -(y + k) + 2.0 * (y * x),
    lambda x, y, k: 1.0 / -(x + k * y) - k * (k + x),
    lambda x, y, _: (-x + y) * (x + -y) + (-x + -y) * (x + y),
    lambda x, y, _: (-x - y) * (x - -y) - (-x - -y) * (x - y),
    lambda x, y, _: -x * y - x * -y * 3.0 + -x * -y * 5.0 + x * y * 7.0,
)


@pytest.mark.parametrize("expression", EXPRESSIONS)
@pytest.mark.parametrize("known", KNOWN)
def test_it_is_the_same_number(expression, known):
    x, y = np.random.default_rng(0).normal(size=(2, 9))
    np.testing.assert_array_equal(unfolded(expression(Folded(x), Folded(y), known)), expression(x, y, known))


def test_what_is_known_leaves_no_operation():
    def function(numbers, _):
        x, y = map(Folded, numbers)
        assert x * 0.0 == 0.0 == 0.0 * y
        total = (0.0 + x * 1.0 - 0.0) + -(-1.0 * y)
        return ((unfolded(total), (-x - y).value),)  # -x - y is -(x + y), whose sum is there

    assert Program(function, [(0.0, 0.0)]).size() == 1
