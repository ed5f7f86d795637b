"""Proof of definiteness in exact rational arithmetic.

Every float is a rational number, so a matrix formed from stored floats by additions and products can be formed
exactly. It is positive definite if T A Tᵀ is strictly diagonally dominant with a positive diagonal for *any* T: that
is Gershgorin's theorem and Sylvester's law (T is then regular, too). T is found in floating point, as the inverse of
the Cholesky factor of A, which makes T A Tᵀ almost the identity; the product and the comparison are exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

__all__ = ["exact", "is_positive_definite", "rational", "smallest_eigenvalue"]


def rational(value: Any) -> fmpq:
    """Return a float, an integer or a rational as the exact rational it is."""
    return value if isinstance(value, fmpq) else fmpq(*value.as_integer_ratio())


def exact(array: Any) -> np.ndarray:
    """Return an array of floats, integers or rationals as an object array of exact rationals."""
    source = np.asarray(array)
    result = np.empty(source.shape, dtype=object)
    for index in np.ndindex(source.shape):
        entry = source[index]
        result[index] = rational(entry.item() if isinstance(entry, np.generic) else entry)
    return result


def smallest_eigenvalue(matrix: np.ndarray) -> float:
    """Return the smallest eigenvalue of a symmetric matrix scaled to unit diagonal, in floating point.

    -inf if the diagonal is not positive. It measures the distance from a singular matrix, whatever the units; it is no
    proof.
    """
    numbers = np.array(matrix, dtype=np.float64)
    diagonal = np.diag(numbers)
    if not (np.isfinite(numbers).all() and (diagonal > 0.0).all()):
        return -np.inf
    scale = 1.0 / np.sqrt(diagonal)
    return float(np.linalg.eigvalsh(scale[:, np.newaxis] * numbers * scale)[0])


def is_positive_definite(matrix: np.ndarray) -> bool:
    """Return whether a symmetric matrix of exact rationals is proven positive definite.

    False means "not proven": the matrix is indefinite, or too close to singular for the floating-point factor.
    """
    if not np.array_equal(matrix, matrix.T):
        return False
    numbers = np.array(matrix, dtype=np.float64)
    diagonal = np.diag(numbers)
    if not (np.isfinite(numbers).all() and (diagonal > 0.0).all()):
        return False
    scale = 1.0 / np.sqrt(diagonal)
    try:
        factor = np.linalg.cholesky(scale[:, np.newaxis] * numbers * scale)
    except np.linalg.LinAlgError:
        return False
    T = np.linalg.inv(factor) * scale
    n = len(T)
    left = fmpq_mat(n, n, list(exact(T).ravel()))
    product = left * fmpq_mat(n, n, list(matrix.ravel())) * left.transpose()
    for i in range(n):
        others = sum((abs(product[i, j]) for j in range(n) if j != i), fmpq(0))
        if not product[i, i] > others:
            return False
    return True
