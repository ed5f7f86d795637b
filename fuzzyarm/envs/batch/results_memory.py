"""Memory for the results of steps, used again where nobody holds them any longer."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

__all__ = ["ResultsMemory", "Room"]

_KEPT = 3  # a loop holds the results of the last step while the next one is made
_LINE = 8  # numbers
_OWN = 2  # references to an array that nobody else holds: the room's, and the argument of `getrefcount`


class Room:
    """Memory for the results of one step.

    Attributes:
        kept: what its user notes about it, as long as it is used again; None at first.
    """

    __slots__ = ("_array", "_first", "_stop", "kept")

    def __init__(self, size: int) -> None:
        """Take memory; it begins where a line of the cache does."""
        self._array = np.empty(size + _LINE)
        self._first = -(self._array.ctypes.data // self._array.itemsize) % _LINE
        self._stop = self._first + size
        self.kept: Any = None

    @property
    def free(self) -> bool:
        """Whether nobody holds its numbers."""
        return sys.getrefcount(self._array) == _OWN

    def array(self) -> np.ndarray:
        """Return its numbers (size,), whatever they are."""
        return self._array[self._first : self._stop]


class ResultsMemory:
    """Rooms of one size.

    Memory that the system has just given is zeroed page by page when it is first written, which takes as long as a
    third of the step of a large batch. Every view of an array holds a reference to it, so that an array without further
    references is not read by anyone any longer.

    Args:
        size: numbers of an array.
    """

    def __init__(self, size: int) -> None:
        """Begin without rooms."""
        self._size, self._rooms = size, list[Room]()

    def room(self) -> Room:
        """Return a room whose numbers nobody else holds."""
        for room in self._rooms:
            if room.free:
                return room
        room = Room(self._size)
        if len(self._rooms) < _KEPT:
            self._rooms.append(room)
        return room

    def __getstate__(self) -> dict[str, object]:
        """Leave the rooms behind."""
        return {"_size": self._size, "_rooms": []}
