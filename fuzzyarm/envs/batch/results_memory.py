"""Memory for the results of steps, used again where nobody holds them any longer."""

from __future__ import annotations

import sys

import numpy as np

__all__ = ["ResultsMemory"]

_KEPT = 3  # a loop holds the results of the last step while the next one is made
_LINE = 8  # numbers
_OWN = 3  # references to an array that nobody else holds: the list, a variable, and the argument of `getrefcount`


class ResultsMemory:
    """Arrays of one size.

    Memory that the system has just given is zeroed page by page when it is first written, which takes as long as a
    third of the step of a large batch. Every view of an array holds a reference to it, so that an array without further
    references is not read by anyone any longer.

    Args:
        size: numbers of an array.
    """

    def __init__(self, size: int) -> None:
        """Begin without arrays."""
        self._size, self._arrays = size, list[np.ndarray]()

    def array(self) -> np.ndarray:
        """Return an array (size,) with any content that nobody else holds; it begins where a line of the cache does."""
        for array in self._arrays:
            if sys.getrefcount(array) == _OWN:
                return self._aligned(array)
        array = np.empty(self._size + _LINE)
        if len(self._arrays) < _KEPT:
            self._arrays.append(array)
        return self._aligned(array)

    def _aligned(self, array: np.ndarray) -> np.ndarray:
        first = -(array.ctypes.data // array.itemsize) % _LINE
        return array[first : first + self._size]

    def __getstate__(self) -> dict[str, object]:
        """Leave the arrays behind."""
        return {"_size": self._size, "_arrays": []}
