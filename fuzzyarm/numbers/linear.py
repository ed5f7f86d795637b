"""Products and solutions of small linear systems, bit for bit the same on every processor.

A linear algebra library selects its kernels by processor, and these round in different orders. Here every number is
computed in one fixed order by +, -, * and /, which IEEE 754 rounds correctly. Arrays (..., m, n)
are stacks of matrices.
"""

import numpy as np

__all__ = ["product", "solved"]


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the matrix product a b, (..., rows, columns), summed in the order of the inner index."""
    total = np.asarray(a[..., :, :1] * b[..., :1, :])
    term = np.empty_like(total)
    for k in range(1, a.shape[-1]):
        total += np.multiply(a[..., :, k : k + 1], b[..., k : k + 1, :], out=term)
    return total


def solved(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a⁻¹ b for a (..., n, n) and b (..., n, columns), by pivoted elimination; inf or nan if a pivot is 0."""
    n, columns = a.shape[-1], a.shape[-1] + b.shape[-1]
    both = np.concatenate([a, np.broadcast_to(b, (*a.shape[:-1], b.shape[-1]))], axis=-1)
    rows = both.reshape(-1, n, columns)
    each = np.arange(len(rows))
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(n):
            pivot = k + np.argmax(np.abs(rows[:, k:, k]), axis=1)
            rows[each, pivot], rows[:, k] = rows[:, k].copy(), rows[each, pivot]
            top = rows[:, k, k:] / rows[:, k, k, np.newaxis]
            rows[:, :, k:] -= rows[:, :, k, np.newaxis] * top[:, np.newaxis]
            rows[:, k, k:] = top
    return both[..., n:]
