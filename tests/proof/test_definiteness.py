"""Proof of definiteness: right on both sides of the boundary, however close."""

import contextlib
from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq

from fuzzyarm.proof.definiteness import exact, is_positive_definite, largest_growth, rational, smallest_eigenvalue


def random_definite(size, smallest, seed=0):
    rng = np.random.default_rng(seed)
    basis, _ = np.linalg.qr(rng.normal(size=(size, size)))
    values = np.concatenate([[smallest], rng.uniform(0.5, 2.0, size - 1)])
    matrix = basis @ np.diag(values) @ basis.T
    return 0.5 * (matrix + matrix.T)


@pytest.mark.parametrize("value", [0.1, -1e-300, 5e-324, 1.7976931348623157e308, 3, -0.0])
def test_rational_is_exact(value):
    number = rational(value)
    assert Fraction(int(number.p), int(number.q)) == Fraction(value)


@pytest.mark.parametrize("smallest", [1.0, 1e-4, 1e-8, 1e-11])
@pytest.mark.parametrize("size", [1, 5, 30])
def test_definite_matrices_are_proven_indefinite_ones_are_not(size, smallest):
    scale = 10.0 ** np.linspace(-8, 8, size)
    for units in (1.0, np.outer(scale, scale)) if smallest > 1e-9 else (1.0,):
        assert is_positive_definite(exact(random_definite(size, smallest) * units))
        assert not is_positive_definite(exact(random_definite(size, -smallest) * units))


def test_what_passes_for_definite_in_floats_alone_is_not_proven():
    """VᵀV - 1e-25 I with V of three rows and four columns: indefinite, yet Cholesky's method takes some of them."""
    rng, taken = np.random.default_rng(0), 0
    for _ in range(40):
        V = rng.integers(-9, 10, (3, 4))
        floats = np.array(V.T @ V, dtype=float)
        root = np.sqrt(np.diag(floats))
        with contextlib.suppress(np.linalg.LinAlgError):
            np.linalg.cholesky(floats / np.outer(root, root))
            taken += smallest_eigenvalue(floats) > -1e-14
        assert not is_positive_definite(exact(V.T @ V) - exact(np.eye(4)) * fmpq(1, 10**25))
    assert taken >= 10


@pytest.mark.parametrize(
    "matrix", [[[0.0]], [[-1.0]], [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.25, 1.0]], [[1e300, 0.0], [0.0, 0.0]]]
)
def test_what_is_not_definite_or_not_symmetric_is_never_proven(matrix):
    assert not is_positive_definite(exact(matrix))


def test_margin_is_free_of_units():
    matrix = random_definite(6, 0.1)
    scale = np.array([1.0, 1e3, 1e-3, 1e6, 1e-6, 1.0])
    assert smallest_eigenvalue(matrix) == pytest.approx(smallest_eigenvalue(matrix * np.outer(scale, scale)))
    assert smallest_eigenvalue(-matrix) == -np.inf


@pytest.mark.parametrize("entry", [fmpq(10) ** 400, -(fmpq(10) ** 400), fmpq(1, 10) ** 400])
def test_numbers_beyond_floating_point_are_not_proven_and_raise_nothing(entry):
    one, nil, inverse = fmpq(1), fmpq(0), 1 / entry
    for matrix in ([[entry, nil], [nil, one]], [[one, entry], [entry, entry]], [[inverse, entry], [entry, inverse]]):
        array = np.array(matrix, dtype=object)
        assert not is_positive_definite(array)
        assert smallest_eigenvalue(array) == -np.inf


@pytest.mark.parametrize("smallest", [1.0, 1e-4, 1e-9])
def test_the_growth_of_everything_is_the_condition_number_rounded_up(smallest):
    matrix = random_definite(6, smallest)
    values = np.linalg.eigvalsh(matrix)
    found = largest_growth(matrix, 6)
    assert values[-1] / values[0] * (1.0 - 1e-6) <= found <= values[-1] / values[0] * (1.0 + 1e-2)
    assert largest_growth(random_definite(4, -1e-3), 4) == np.inf


def test_the_growth_of_a_part_is_of_the_worst_start_and_the_worst_end_at_the_same_value():
    """V = xᵀAx does not rise: from x = (a, 0), no state of the same V has a longer first part than c |a|."""
    matrix, rng = random_definite(5, 1e-3, seed=2), np.random.default_rng(0)
    c, inverse = np.sqrt(largest_growth(matrix, 2)), np.linalg.inv(matrix)
    start = np.linalg.eigh(matrix[:2, :2])[1][:, -1]
    along = np.linalg.eigh(inverse[:2, :2])[1][:, -1]
    worst = inverse[:, :2] @ along
    worst *= np.sqrt(start @ matrix[:2, :2] @ start / (worst @ matrix @ worst))
    assert (1.0 - 1e-6) * c < np.linalg.norm(worst[:2]) <= c
    for _ in range(100):
        a, x = rng.normal(size=2), rng.normal(size=5)
        x *= np.sqrt(a @ matrix[:2, :2] @ a / (x @ matrix @ x))
        assert np.linalg.norm(x[:2]) <= c * np.linalg.norm(a)
