"""The elementwise functions: against arithmetic of 40 digits, and the same bits from NumPy and compiled code."""

import mpmath
import numpy as np
import pytest
from support.machine_code import on_machine

from fuzzyarm.envs.physics.elementwise import gaussian, positive_part, root, select, sign, sine_cosine, smaller

PRECISE = mpmath.MPContext()
PRECISE.dps = 40
SPECIAL = np.array([0.0, -0.0, 5e-324, -5e-324, 1e-308, 1e300, -1e300, np.inf, -np.inf, np.nan])


def neighbours(points):
    return np.concatenate([points, np.nextafter(points, np.inf), np.nextafter(points, -np.inf)])


def angles():
    """Angles within ±2π: everywhere, at the borders of the octants and quadrants, and near zero."""
    rng = np.random.default_rng(0)
    borders = neighbours(np.arange(-8, 9) * np.pi / 4)
    small = 10.0 ** rng.uniform(-300, 0, 300) * rng.choice([-1.0, 1.0], 300)
    everywhere = np.concatenate([rng.uniform(-2.0 * np.pi, 2.0 * np.pi, 2000), borders, small, [0.0, -0.0]])
    return everywhere[np.abs(everywhere) <= 2.0 * np.pi]


def numbers():
    rng = np.random.default_rng(1)
    sizes = 10.0 ** rng.uniform(-320, 308, 500) * rng.choice([-1.0, 1.0], 500)
    return np.concatenate([rng.uniform(-10.0, 10.0, 2000), sizes, angles(), SPECIAL])


def error(found, exact, points):
    """Largest absolute error against a function of mpmath."""
    pairs = zip(found.tolist(), points.tolist(), strict=True)
    return max(float(abs(PRECISE.mpf(y) - exact(PRECISE.mpf(x)))) for y, x in pairs)


def bits(values):
    """The bits of floats; every nan counts as the same."""
    values = np.array(values, dtype=np.float64)
    return np.where(np.isnan(values), np.nan, values).view(np.uint64)


def test_sine_and_cosine_are_right_to_3e_16_up_to_a_million():
    """Also where the reduction is at its worst: floats next to multiples of π/2, the result next to zero."""
    rng = np.random.default_rng(2)
    multiples = neighbours(rng.integers(-636_000, 636_000, 300) * (np.pi / 2.0))
    x = np.concatenate([angles(), rng.uniform(-1e6, 1e6, 1000), multiples])
    sine, cosine = sine_cosine(x)
    assert error(sine, PRECISE.sin, x) < 3e-16 and error(cosine, PRECISE.cos, x) < 3e-16
    assert np.array_equal(sine_cosine(-x)[0], -sine) and np.array_equal(sine_cosine(-x)[1], cosine)
    assert sine_cosine(np.float64(-0.0)) == (0.0, 1.0)
    with np.errstate(invalid="ignore"):
        assert np.isnan(sine_cosine(np.array([np.nan, np.inf, -np.inf]))).all()
    # Small sines keep their relative precision.
    x = 10.0 ** np.random.default_rng(3).uniform(-300, -1, 300)
    pairs = zip(x.tolist(), sine_cosine(x)[0].tolist(), strict=True)
    assert max(float(abs(y / PRECISE.sin(PRECISE.mpf(value)) - 1)) for value, y in pairs) < 2.0**-52


def test_gaussian_is_right_to_3e_14_and_stays_at_4e_18_far_out():
    rng = np.random.default_rng(4)
    small = 10.0 ** rng.uniform(-200, 0, 200)
    x = np.concatenate([rng.uniform(-7.0, 7.0, 3000), small, neighbours(np.array([0.0, 40.0**0.5, -(40.0**0.5)]))])
    assert error(gaussian(x), lambda y: PRECISE.exp(-y * y), x) < 3e-14 and gaussian(np.float64(0.0)) == 1.0
    far = np.array([6.4, 100.0, 1e150, 1e300, np.inf])
    with np.errstate(over="ignore"):
        np.testing.assert_allclose(gaussian(np.concatenate([far, -far])), np.exp(-40.0), rtol=1e-10)


def test_sign_positive_part_smaller_and_select_are_numpys_and_root_is_correctly_rounded():
    x = numbers()
    assert np.array_equal(sign(x), np.where(np.isnan(x), 0.0, np.sign(x)))
    x = x[np.abs(x) < 8e307]
    assert np.array_equal(positive_part(x), np.maximum(x, 0.0))
    a, b = x, np.random.default_rng(5).permutation(x)
    assert np.array_equal(smaller(a, b), np.minimum(a, b))
    assert np.array_equal(select(a > b, 7.0, b), np.where(a > b, 7.0, b))
    x = 10.0 ** np.random.default_rng(6).uniform(-300, 300, 500)
    assert root(x).tolist() == [float(PRECISE.sqrt(PRECISE.mpf(value))) for value in x.tolist()]


def everything(a, b):
    return *sine_cosine(a), gaussian(a), root(abs(a)), sign(a), positive_part(a), smaller(a, b), select(a > b, a, b)


@pytest.mark.parametrize("lanes", [1, 4000])
def test_numpy_floats_and_machine_code_give_the_same_bits(lanes):
    x = numbers()
    pairs = np.stack([x, x[::-1]], axis=1)[: lanes if lanes > 1 else 40]
    with np.errstate(all="ignore"):
        in_arrays = np.stack(everything(*pairs.T), axis=1)
        in_floats = np.array([everything(*map(np.float64, pair)) for pair in pairs])
    parts = [pairs] if lanes > 1 else np.split(pairs, len(pairs))
    found = np.vstack([on_machine(everything, part) for part in parts])
    assert np.array_equal(bits(found), bits(in_arrays)) and np.array_equal(bits(in_floats), bits(in_arrays))
