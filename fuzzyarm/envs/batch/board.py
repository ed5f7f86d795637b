"""What threads in compiled code tell each other: a row of whole numbers, on which a step is posted piece by piece.

Threads that wait for Python's lock, or sleep, begin a hundred microseconds late, which is as long as a step of a
thousand lanes takes. Here a thread looks at the board until a piece is left to take, and takes it by counting `next` up
in one atomic operation. What is posted stays until all pieces are `done`, so that whoever has a piece may read it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import carray, int64, types
from numba.core import cgutils
from numba.extending import intrinsic, register_jitable

from fuzzyarm.envs.physics.compiled import kernel

__all__ = ["AT", "BOARD", "Place", "array_at", "finish", "post", "take", "wait"]

_LINE = 8  # numbers of a line of the cache: what one thread counts shall not slow down who reads something else


class Place(NamedTuple):
    """Places on the board.

    Attributes:
        next: the piece to take next.
        done: how many pieces are done.
        pieces: how many there are.
        size: lanes of a piece.
        lanes: how many there are.
        rows: of the table.
        values: address of what `kernels.advance_of` calls so; the others likewise.
    """

    next: int
    done: int
    pieces: int
    size: int
    lanes: int
    rows: int
    values: int
    clock: int
    table: int
    action: int
    out: int


AT = Place(0, _LINE, *range(2 * _LINE, 2 * _LINE + 9))
"""Where each number of a board is."""
BOARD = AT.out + _LINE
"""Numbers of a board."""


@intrinsic
def _read(_: Any, address: Any) -> Any:
    """Return the number at an address, with all that was written before it was."""

    def write(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        return builder.load_atomic(_place(builder, arguments[0]), "acquire", 8)

    return int64(address), write


@intrinsic
def _add(_: Any, address: Any, number: Any) -> Any:
    """Add to the number at an address, and return what it was."""

    def write(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        return builder.atomic_rmw("add", _place(builder, arguments[0]), arguments[1], "seq_cst")

    return int64(address, int64), write


@intrinsic
def _set(_: Any, address: Any, number: Any) -> Any:
    """Set the number at an address, after all that was written before, and return what it was."""

    def write(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        return builder.atomic_rmw("xchg", _place(builder, arguments[0]), arguments[1], "seq_cst")

    return int64(address, int64), write


@intrinsic
def _pointer(_: Any, address: Any) -> Any:
    """Return the pointer to an address."""

    def write(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), write


def _place(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, cgutils.ir.IntType(64).as_pointer())


@register_jitable
def array_at(address: int, shape: Any, dtype: Any) -> np.ndarray:
    """Return the array of a shape, (lanes, joints) for example, at an address; the unit is that of what lies there."""
    found: np.ndarray = carray(_pointer(address), shape, dtype)
    return found


@kernel
def post(
    board: np.ndarray, values: np.ndarray, clock: np.ndarray, table: np.ndarray, action: np.ndarray, out: np.ndarray
) -> int:
    """Post a step and return -1; post nothing, and return the first lane whose torques are not all finite.

    `board` (BOARD,) says into how many pieces of what size the lanes are divided; arguments as in `kernels.advance_of`.
    """
    bad = 0
    for lane in range(action.shape[0]):
        for joint in range(action.shape[1]):
            bad |= not np.isfinite(action[lane, joint])
    if bad:
        for lane in range(action.shape[0]):
            for joint in range(action.shape[1]):
                if not np.isfinite(action[lane, joint]):
                    return lane
    board[AT.values], board[AT.clock], board[AT.table] = values.ctypes.data, clock.ctypes.data, table.ctypes.data
    board[AT.action], board[AT.out], board[AT.rows] = action.ctypes.data, out.ctypes.data, table.shape[0]
    _set(board.ctypes.data + 8 * AT.done, 0)
    _set(board.ctypes.data + 8 * AT.next, 0)
    return -1


@register_jitable
def take(board: np.ndarray, looks: int) -> int:
    """Return a piece to do, -1 if there was none in so many looks at the board (BOARD,)."""
    for _ in range(looks):
        if _read(board.ctypes.data + 8 * AT.next) < board[AT.pieces]:
            piece: int = _add(board.ctypes.data + 8 * AT.next, 1)
            if piece < board[AT.pieces]:
                return piece
    return -1


@register_jitable
def finish(board: np.ndarray) -> None:
    """Say on the board (BOARD,) that a piece is done."""
    _add(board.ctypes.data + 8 * AT.done, 1)


@register_jitable
def wait(board: np.ndarray) -> None:
    """Wait until all pieces on the board (BOARD,) are done."""
    while _read(board.ctypes.data + 8 * AT.done) < board[AT.pieces]:
        pass
