"""The functions that equations use beyond arithmetic and comparisons, for every kind of number.

Each kind of number has a class in `KINDS` with these functions as static methods. Floats need no class: each function
computes with them in Python.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

__all__ = [
    "KINDS", "RECORDERS", "Cells", "apart", "array", "bits", "each", "entry", "flat", "floor", "like", "maximum",
    "minimum", "number", "only", "repeat", "row", "select", "when", "whole", "word", "zeros",
]  # fmt: skip

KINDS: dict[type, Any] = {}  # the class with the functions, by type of number


def select(condition: Any, first: Any, second: Any) -> Any:
    """Return `first` where the condition holds, else `second`."""
    kind = KINDS.get(type(condition))
    return kind.select(condition, first, second) if kind else first if condition else second


def minimum(a: Any, b: Any) -> Any:
    """Return b where b < a, else a; thus a where either is nan."""
    return select(b < a, b, a)


def maximum(a: Any, b: Any) -> Any:
    """Return b where b > a, else a; thus a where either is nan."""
    return select(b > a, b, a)


def floor(x: Any) -> Any:
    """Return the largest whole number that is not above x, as a number of the same kind."""
    kind = KINDS.get(type(x))
    return kind.floor(x) if kind else float(x // 1.0)


def apart(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a function of numbers and records to remain a separate function in exported C."""

    @functools.wraps(function)
    def called(*arguments: Any) -> Any:
        if RECORDERS and hasattr(RECORDERS[-1], "apart"):
            return RECORDERS[-1].apart(function, arguments)
        return function(*arguments)

    return called


def row(table: Any, place: Any) -> tuple[Any, ...]:
    """Return the entries of a row of a table; an index outside the table selects the nearest row, nan the first."""
    kind = KINDS.get(type(place))
    if kind:
        return tuple(kind.row(table, place))
    return tuple(table[min(max(int(place), 0), len(table) - 1) if place == place else 0])


def entry(table: Any, place: Any, column: Any) -> Any:
    """Return the entry in `column` of `row(table, place)`; `column` may be the index of a loop."""
    kind = KINDS.get(type(place))
    if kind:
        return kind.entry(table, place, column)
    return table[min(max(int(place), 0), len(table) - 1) if place == place else 0][column]


def repeat(count: Any, function: Callable[[Any], Any], carried: Any) -> Any:
    """Return function(function(... carried)), applied `count` times; `carried` and the result are trees of numbers."""
    for number in flat(carried):
        if (kind := KINDS.get(type(number))) and hasattr(kind, "repeat"):
            return kind.repeat(count, function, carried)
    for _ in range(int(count)):
        carried = function(carried)
    return carried


def when(condition: Any, function: Callable[[], Any], otherwise: Any) -> Any:
    """Return function(), called if the condition holds for any arm, where it holds; else `otherwise`, of equal size."""
    kind = KINDS.get(type(condition))
    if kind:
        return kind.when(condition, function, otherwise)
    return function() if condition else otherwise


def word(x: Any) -> Any:
    """Return the 64 bits of a number as a uint64; see `bits`."""
    kind = KINDS.get(type(x))
    return kind.word(x) if kind else np.float64(x).view(np.uint64)


def bits(of: Any) -> Any:
    """Return the floating-point number with the same 64 bits as a uint64, so that arrays of floats can store words."""
    kind = KINDS.get(type(of))
    return kind.bits(of) if kind else of.view(np.float64)


def whole(x: Any) -> Any:
    """Return a whole number from 0 to 2^53 as a uint64; see `number`."""
    kind = KINDS.get(type(x))
    return kind.whole(x) if kind else np.uint64(x)


def number(of: Any) -> Any:
    """Return a uint64 of at most 2^53 as a floating-point number, exactly."""
    kind = KINDS.get(type(of))
    return kind.number(of) if kind else of * 1.0


RECORDERS: list[Any] = []  # the programs being recorded, the innermost last; see `program.Program`


@dataclasses.dataclass(frozen=True)
class Cells:
    """A placeholder for an array of this shape in a tree of numbers."""

    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of entries of the array."""
        return math.prod(self.shape)


def array(*shape: int) -> Any:
    """Return an array with undefined content; a program for many arms has one such array for each arm."""
    return RECORDERS[-1].array(shape) if RECORDERS else np.full(shape, np.nan)


def each(count: Any) -> Iterable[Any]:
    """Return 0, 1, ..., count - 1, for a loop whose body reads and writes arrays.

    A recorded body runs once, so only arrays carry numbers from one iteration to the next.
    """
    return RECORDERS[-1].each(count) if RECORDERS else range(count)


def only(condition: Any) -> Iterable[None]:
    """Return an iterable for a loop that runs once if the condition holds; the body must write results to arrays."""
    kind = KINDS.get(type(condition))
    if kind:
        return kind.only(condition)  # type: ignore[no-any-return]
    return (None,) if condition else ()


def flat(tree: Any) -> list[Any]:
    """Return the numbers of nested tuples, in order; an array of lanes counts as one, `Cells` as a zero per entry."""
    if isinstance(tree, tuple):
        return [number for part in tree for number in flat(part)]
    if isinstance(tree, Cells):
        return [0.0] * tree.size
    return [tree]


def like(tree: Any, numbers: Iterator[Any], cells: Callable[[Cells], Any] | None = None) -> Any:
    """Return a tree with the structure of `tree` and other numbers; `Cells` become arrays, or results of `cells`."""
    if isinstance(tree, Cells):
        if cells is not None:
            return cells(tree)
        filled = np.empty(tree.size, dtype=object)
        filled[:] = [next(numbers) for _ in range(tree.size)]
        return filled.reshape(tree.shape)
    if not isinstance(tree, tuple):
        return next(numbers)
    parts = [like(part, numbers, cells) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)


def zeros(tree: Any) -> Any:
    """Return a tree with the structure of `tree` in which all numbers are zero and each `Cells` object is unchanged."""
    return like(tree, itertools.repeat(0.0), lambda cells: cells)
