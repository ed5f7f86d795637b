"""Consecutive slices, from which the named parts of an array are made."""

from __future__ import annotations

__all__ = ["consecutive"]


def consecutive(*sizes: int) -> list[slice]:
    """Return adjacent slices of these lengths, the first of which begins at 0.

    >>> consecutive(2, 1)
    [slice(0, 2, None), slice(2, 3, None)]
    """
    slices, start = [], 0
    for size in sizes:
        slices.append(slice(start, start + size))
        start += size
    return slices
