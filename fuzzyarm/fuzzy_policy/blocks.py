"""Lanes that a law acts on together: their numbers in rows of a block, so that loops over lanes become SIMD code.

A block is a flat array of rows of `BLOCK` numbers, addressed as `records.in_block` says. A law copies the lanes of its
arguments into one, loops over lanes innermost, over this one array with constant places and without branches, and
copies back what has changed. Every lane has the operations of a lane alone in their order, and so its bits.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.records import BLOCK

__all__ = ["into_block", "out_of_block"]


@register_jitable(forceinline=True)
def into_block(array: np.ndarray, first: int, lanes: int, block: np.ndarray, row: int) -> None:
    """Copy `lanes` lanes of an array (all lanes, k) from `first` on into k rows of a block (rows x BLOCK,)."""
    # Without a sign, an index needs no look whether it counts from the end.
    start, wide = np.uint64(first), np.uint64(BLOCK)
    for k in range(np.uint64(array.shape[1])):
        for lane in range(np.uint64(lanes)):
            block[(np.uint64(row) + k) * wide + lane] = array[start + lane, k]


@register_jitable(forceinline=True)
def out_of_block(block: np.ndarray, row: int, array: np.ndarray, first: int, lanes: int) -> None:
    """Copy k rows of a block (rows x BLOCK,) into `lanes` lanes of an array (all lanes, k) from `first` on."""
    start, wide = np.uint64(first), np.uint64(BLOCK)
    for k in range(np.uint64(array.shape[1])):
        for lane in range(np.uint64(lanes)):
            array[start + lane, k] = block[(np.uint64(row) + k) * wide + lane]
