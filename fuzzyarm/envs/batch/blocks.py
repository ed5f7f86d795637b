"""The numbers of lanes in blocks, as the kernels have them, and in rows, as states and readers have them."""

from __future__ import annotations

import numpy as np

from fuzzyarm.numbers.machine import WIDE

__all__ = ["by_rows", "in_blocks"]


def by_rows(values: np.ndarray, lanes: int) -> np.ndarray:
    """Return values (blocks, rows, `WIDE`) of so many lanes as (rows, lanes), a copy in the same units."""
    return np.ascontiguousarray(np.swapaxes(values, 0, 1).reshape(values.shape[1], -1)[:, :lanes])


def in_blocks(values: np.ndarray) -> np.ndarray:
    """Return values (rows, lanes) as (blocks, rows, `WIDE`) in the same units; nan where there is no lane."""
    rows, lanes = values.shape
    padded = np.full((rows, -(-lanes // WIDE) * WIDE), np.nan)
    padded[:, :lanes] = values
    return np.ascontiguousarray(np.swapaxes(padded.reshape(rows, -1, WIDE), 0, 1))
