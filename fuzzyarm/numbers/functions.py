"""What equations use beyond arithmetic and comparisons, for every kind of number.

A kind is a class with these names as static methods; `KINDS` finds it by the type of a number. Floats need none: for
them each function is what Python does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

__all__ = [
    "KINDS", "bits", "flat", "floor", "like", "maximum", "minimum", "number", "repeat", "row", "select", "when",
    "whole", "word", "zeros",
]  # fmt: skip

KINDS: dict[type, Any] = {}
"""By type of number, the class of what it does in place of a float."""


def select(condition: Any, first: Any, second: Any) -> Any:
    """Return `first` where the condition holds, else `second`."""
    kind = KINDS.get(type(condition))
    return kind.select(condition, first, second) if kind else first if condition else second


def minimum(a: Any, b: Any) -> Any:
    """Return the second only where it is less: `a` where one is not a number."""
    return select(b < a, b, a)


def maximum(a: Any, b: Any) -> Any:
    """Return the second only where it is greater: `a` where one is not a number."""
    return select(b > a, b, a)


def floor(x: Any) -> Any:
    """Return the largest whole number that is not above x, as a number of the same kind."""
    kind = KINDS.get(type(x))
    return kind.floor(x) if kind else float(x // 1.0)


def row(table: Any, place: Any) -> tuple[Any, ...]:
    """Return the numbers of a row of a table; a place outside is the nearest one inside, and nan the first."""
    kind = KINDS.get(type(place))
    if kind:
        return tuple(kind.row(table, place))
    return tuple(table[min(max(int(place), 0), len(table) - 1) if place == place else 0])


def repeat(count: Any, function: Callable[[Any], Any], carried: Any) -> Any:
    """Return function(function(... carried)), `count` times; `carried` is a tree of numbers, and so is what comes."""
    for number in flat(carried):
        if (kind := KINDS.get(type(number))) and hasattr(kind, "repeat"):
            return kind.repeat(count, function, carried)
    for _ in range(int(count)):
        carried = function(carried)
    return carried


def when(condition: Any, function: Callable[[], Any], otherwise: Any) -> Any:
    """Return function() where the condition holds, else `otherwise`, a tree of as many numbers.

    Many arms at once compute function() only if the condition holds for one of them.
    """
    kind = KINDS.get(type(condition))
    if kind:
        return kind.when(condition, function, otherwise)
    return function() if condition else otherwise


def word(x: Any) -> Any:
    """Return the 64 bits of a number, a uint64; see `bits`."""
    kind = KINDS.get(type(x))
    return kind.word(x) if kind else np.float64(x).view(np.uint64)


def bits(of: Any) -> Any:
    """Return the number with the 64 bits of a uint64: how an array of numbers holds a word."""
    kind = KINDS.get(type(of))
    return kind.bits(of) if kind else of.view(np.float64)


def whole(x: Any) -> Any:
    """Return a whole number from 0 to 2^53 as a uint64; see `number`."""
    kind = KINDS.get(type(x))
    return kind.whole(x) if kind else np.uint64(x)


def number(of: Any) -> Any:
    """Return a uint64 that is at most 2^53 as a number; exact."""
    kind = KINDS.get(type(of))
    return kind.number(of) if kind else of * 1.0


def flat(tree: Any) -> list[Any]:
    """Return the numbers of nested tuples, in order."""
    return [number for part in tree for number in flat(part)] if isinstance(tree, tuple) else [tree]


def like(tree: Any, numbers: Iterator[Any]) -> Any:
    """Return nested tuples of the same kinds with other numbers."""
    if not isinstance(tree, tuple):
        return next(numbers)
    parts = [like(part, numbers) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)


def zeros(tree: Any) -> Any:
    """Return nested tuples of the same kinds with zeros."""
    return like(tree, iter(lambda: 0.0, None))
