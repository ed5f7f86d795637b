"""Symmetric block matrices written as the paper prints them: the lower triangle, with 0 and ⋆ for the rest.

`block` is `np.block` for arrays (floats or exact rationals) and `cvxpy.bmat` for expressions. Zeros and identities
are integers everywhere, so that an exact entry never meets a float.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

__all__ = ["Block", "he", "identity", "symmetric", "zeros"]

Block = Callable[[list[list[Any]]], Any]
"""Puts a matrix together from rows of blocks."""


def he(matrix: Any) -> Any:
    """Return He(Y) = Y + Yᵀ."""
    return matrix + matrix.T


def zeros(rows: int, columns: int) -> np.ndarray:
    """Return a zero block (rows, columns) of whole numbers."""
    return np.zeros((rows, columns), dtype=int)


def identity(size: int) -> np.ndarray:
    """Return an identity block (size, size) of whole numbers."""
    return np.eye(size, dtype=int)


def symmetric(lower: Sequence[Sequence[Any]], block: Block) -> Any:
    """Return the symmetric matrix with the block rows `lower`, each up to the diagonal; 0 stands for a zero block."""
    sizes = [row[-1].shape[0] for row in lower]

    def entry(row: int, column: int) -> Any:
        if column > row:
            return entry(column, row).T
        given = lower[row][column]
        return zeros(sizes[row], sizes[column]) if isinstance(given, int) else given

    return block([[entry(row, column) for column in range(len(sizes))] for row in range(len(sizes))])
