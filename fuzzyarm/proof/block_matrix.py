"""Symmetric block matrices in the paper's notation: the lower triangle, with 0 and ⋆ for the rest.

The inequalities are written for matrices (r, c) or stacks of matrices (..., r, c), of floats or of exact rationals.
Other kinds of entries must register their own `transposed` and `times`, as `synthesis._expressions` does for cvxpy.
Zeros and identities are integers, so that exact entries are never mixed with floats.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

__all__ = ["Assembly", "he", "identity", "symmetric", "times", "transposed"]

Assembly = Callable[[list[list[Any]]], Any]
"""A function that assembles a matrix from the block rows of its lower triangle; see `symmetric`."""


@functools.singledispatch
def transposed(matrix: Any) -> Any:
    """Return the transpose Yᵀ of a matrix Y, or of each matrix of a stack (..., r, c)."""
    return np.swapaxes(matrix, -1, -2)


@functools.singledispatch
def times(scale: Any, matrix: Any) -> Any:
    """Return the product of each matrix of a stack (..., r, c) with its own entry of `scale` (...)."""
    return np.asarray(scale)[..., np.newaxis, np.newaxis] * matrix


def he(matrix: Any) -> Any:
    """Return He(Y) = Y + Yᵀ for a square matrix Y or a stack of them."""
    return matrix + transposed(matrix)


def identity(size: int) -> np.ndarray:
    """Return an identity block (size, size) of whole numbers."""
    return np.eye(size, dtype=int)


def symmetric(lower: Sequence[Sequence[Any]]) -> np.ndarray:
    """Return symmetric matrices (..., r, r); row i of `lower` has blocks 0 to i, in any unit; 0 is a zero block."""
    ends = np.cumsum([row[-1].shape[-1] for row in lower])
    places = [slice(end - row[-1].shape[-1], end) for row, end in zip(lower, ends.tolist(), strict=True)]
    blocks = [entry for row in lower for entry in row if not isinstance(entry, int)]
    stack = np.broadcast_shapes(*(block.shape[:-2] for block in blocks))
    whole = np.zeros((*stack, ends[-1], ends[-1]), dtype=np.result_type(*blocks))
    for row, entries in enumerate(lower):
        for column, entry in enumerate(entries):
            if not isinstance(entry, int):
                whole[..., places[row], places[column]] = entry
                whole[..., places[column], places[row]] = transposed(entry)
    return whole
