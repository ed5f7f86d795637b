"""The block matrices of the theorems as cvxpy expressions; `proof.block_matrix` builds them from numbers.

A stack of matrices of any length is one expression (..., r, c) and one constraint, and compiles in milliseconds.
"""

from typing import Any

import cvxpy as cp
import numpy as np

from fuzzyarm.proof.block_matrix import times, transposed

__all__ = ["half", "negative", "positive"]


@transposed.register(cp.Expression)
def _transposed(matrix: Any) -> Any:
    return cp.swapaxes(matrix, len(matrix.shape) - 2, len(matrix.shape) - 1)


@times.register(cp.Expression)
def _times(scale: Any, matrix: Any) -> Any:
    return cp.multiply(scale[..., None, None], matrix) if scale.shape else scale * matrix


def half(lower: list[list[Any]]) -> Any:
    """Return F, one matrix or a stack, with F + Fᵀ = `block_matrix.symmetric(lower)`; there is half as much to compile.

    The blocks of F below the diagonal are those of `lower`, those on the diagonal are halved, and those above are 0.
    """
    sizes = [row[-1].shape[-1] for row in lower]
    stack = np.broadcast_shapes(*(one.shape[:-2] for row in lower for one in row if not isinstance(one, int)))
    axis = len(stack)

    def wide(block: Any) -> Any:
        shape = (*stack, *block.shape[-2:])
        return (np if isinstance(block, np.ndarray) else cp).broadcast_to(block, shape)

    rows = []
    for size, row in zip(sizes, lower, strict=True):
        entries = [*row[:-1], 0.5 * row[-1], *[0] * (len(sizes) - len(row))]
        blocks = [
            np.zeros((*stack, size, columns)) if isinstance(entry, int) else wide(entry)
            for entry, columns in zip(entries, sizes, strict=True)
        ]
        joined: list[Any] = []  # adjacent numerical blocks are joined
        for block in blocks:
            if joined and isinstance(block, np.ndarray) and isinstance(joined[-1], np.ndarray):
                joined[-1] = np.concatenate([joined[-1], block], axis=axis + 1)
            else:
                joined.append(block)
        rows.append(cp.concatenate(joined, axis=axis + 1) if len(joined) > 1 else joined[0])
    return cp.concatenate(rows, axis=axis)


def positive(half_matrix: Any, margin: float = 0.0) -> Any:
    """Return the constraint F + Fᵀ >= `margin` I on each F of a stack; cvxpy reads the symmetric part of 2F."""
    return 2.0 * half_matrix - margin * np.eye(half_matrix.shape[-1]) >> 0


def negative(half_matrix: Any, margin: float = 0.0) -> Any:
    """Return the constraint F + Fᵀ <= -`margin` I on each F of the stack `half_matrix`."""
    return positive(-half_matrix, margin)
