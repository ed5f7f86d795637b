"""Proof of definiteness in exact rational arithmetic.

Every float is a rational number, so a matrix A formed from stored floats by additions and products can be formed
exactly. A is positive definite if there is a matrix T for which T A Tᵀ is strictly diagonally dominant with a positive
diagonal, by Gershgorin's theorem and Sylvester's law (T is then regular, too). T is the inverse of the Cholesky factor
of A in floating point, for which T A Tᵀ is almost the identity; the product and the comparison are exact.
"""

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

__all__ = [
    "exact", "inverse", "is_dominant", "is_positive_definite", "largest_growth", "largest_of_inverse", "rational",
    "smallest_eigenvalue", "stated",
]  # fmt: skip


def rational(value: Any) -> fmpq:
    """Return a float, an integer or a rational as an exact rational."""
    return value if isinstance(value, fmpq) else fmpq(*value.as_integer_ratio())


def stated(value: float) -> fmpq:
    """Return the shortest decimal number that identifies a float, its `repr`, as an exact rational.

    A text states this number: 0.1 is 1/10, although the float is slightly larger.
    """
    return rational(Fraction(repr(float(value))))


def exact(array: Any) -> np.ndarray:
    """Return an array of floats, integers or rationals as an object array of exact rationals."""
    return np.asarray(np.frompyfunc(rational, 1, 1)(np.asarray(array).astype(object)), dtype=object)


def inverse(matrix: np.ndarray) -> np.ndarray | None:
    """Return the inverse of a square matrix of exact rationals, exactly; None if it is singular."""
    n = len(matrix)
    try:
        return np.array(fmpq_mat(n, n, list(matrix.ravel())).inv().tolist(), dtype=object)
    except ZeroDivisionError:
        return None


def smallest_eigenvalue(matrix: np.ndarray) -> float:
    """Scale a symmetric matrix to unit diagonal, and return its smallest eigenvalue, in floats, not proven."""
    scaled = _scaled(matrix)
    return -np.inf if scaled is None else float(np.linalg.eigvalsh(scaled[0])[0])


def is_positive_definite(matrix: np.ndarray) -> bool:
    """Return whether a symmetric matrix of exact rationals is proven positive definite.

    False means "not proven": the matrix is indefinite, or too close to singular for the floating-point factor.
    """
    if not np.array_equal(matrix, matrix.T):
        return False
    scaled = _scaled(matrix)
    if scaled is None:
        return False
    try:
        factor = np.linalg.cholesky(scaled[0])
    except np.linalg.LinAlgError:
        return False
    T = np.linalg.inv(factor) * scaled[1]
    if not np.isfinite(T).all():
        return False
    n = len(T)
    left = fmpq_mat(n, n, list(exact(T).ravel()))
    return is_dominant(left * fmpq_mat(n, n, list(matrix.ravel())) * left.transpose())


def is_dominant(matrix: Any) -> bool:
    """Return whether a FLINT matrix is strictly diagonally dominant, row by row, with a positive diagonal."""
    rows = enumerate(matrix.tolist())
    return all(bool(row[i] > sum((abs(x) for j, x in enumerate(row) if j != i), 0 * row[i])) for i, row in rows)


def largest_growth(matrix: np.ndarray, size: int) -> float:
    """Return c² for |x_1(t)| <= c exp(-αt) |x_1(0)| if V = xᵀAx or xᵀA⁻¹x decays as exp(-2αt); inf without a proof.

    A is `matrix`; x_1 has the first `size` entries of x, the others are initially 0. c² is a proven upper bound on
    λmax(A_11) λmax((A⁻¹)_11): A_11 < λI, and (A⁻¹)_11 < μI if A > diag(I/μ, 0). For x_1 = x: A's condition number.
    """
    A = exact(matrix)[:size, :size]
    highest = _proven(np.linalg.eigvalsh(matrix[:size, :size]), lambda x: x * exact(np.eye(size)) - A)
    return highest * largest_of_inverse(matrix, size)


def largest_of_inverse(matrix: np.ndarray, size: int) -> float:
    """Return a bound on the largest eigenvalue of the leading block (size, size) of matrix⁻¹; inf without a proof."""
    first = exact(np.diag(np.arange(len(matrix)) < size).astype(float))
    values = np.linalg.eigvalsh(np.linalg.pinv(matrix)[:size, :size])
    return _proven(values, lambda x: exact(matrix) - first / x)


def _proven(values: np.ndarray, rest: Callable[[fmpq], np.ndarray]) -> float:
    """Return an x slightly above the eigenvalues `values` with `rest(x)` proven positive definite; else inf."""
    tried = (float(values[-1]) * (1.0 + 10.0**-digits) for digits in range(9, 1, -1))
    return next((x for x in tried if 0.0 < x < math.inf and is_positive_definite(rest(rational(x)))), math.inf)


def _scaled(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return D A D with unit diagonal, and the diagonal of D (n,), in floats, for a matrix A; None if not finite."""
    try:
        numbers = np.array(matrix, dtype=np.float64)
    except OverflowError:
        return None
    diagonal = np.diag(numbers)
    if not (np.isfinite(numbers).all() and (diagonal > 0.0).all()):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    with np.errstate(over="ignore"):
        scaled = scale[:, np.newaxis] * numbers * scale
    return (scaled, scale) if np.isfinite(scaled).all() else None
