"""Records in arrays: where the numbers of a record stand, and compiled functions that read and write them.

A record is a NamedTuple whose fields are numbers or further records. In an array its numbers stand one after the
other in the order of the fields, so every offset follows from the declaration of the record, here and nowhere else:

    class Load(NamedTuple):
        torque: PerJoint
        mass: Any

    size(Load)                         # 3
    places(Load).mass                  # 2
    columns(Load).torque               # slice(0, 2)
    read = reader(Load, in_columns)    # read(table, k) returns Load(PerJoint(table[k, 0], table[k, 1]), table[k, 2])

Readers and writers are generated as source, as `dataclasses` does it: written-out constant indices are what lets the
compiler keep a record in registers and turn a loop over lanes into SIMD code.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from numba.extending import register_jitable

__all__ = [
    "BLOCK",
    "JOINTS",
    "PerJoint",
    "Point",
    "columns",
    "in_block",
    "in_columns",
    "in_list",
    "in_rows",
    "places",
    "reader",
    "size",
    "times",
    "writer",
]

BLOCK = 32
"""Lanes that are advanced together: their numbers stay in the fastest cache."""


class PerJoint(NamedTuple):
    """One number for each joint."""

    joint1: Any
    joint2: Any


class Point(NamedTuple):
    """A vector in the plane of the arm: x points down, y to the right."""

    x: Any
    y: Any


JOINTS = len(PerJoint._fields)
"""How many joints the arm has."""


@register_jitable(forceinline=True)
def times(numbers: Any, factors: Any) -> PerJoint:
    """Return the products, joint by joint."""
    return PerJoint(numbers[0] * factors[0], numbers[1] * factors[1])


def size(record: type) -> int:
    """Return how many numbers a record has."""
    return sum(size(kind) if _is_record(kind) else 1 for _, kind in _fields(record))


def places(record: type, first: int = 0) -> Any:
    """Return the record with, for each number, the place where it stands in an array; the first is at `first`."""
    values = []
    for _, kind in _fields(record):
        values.append(places(kind, first) if _is_record(kind) else first)
        first += size(kind) if _is_record(kind) else 1
    return record(*values)


def columns(record: type) -> Any:
    """Return the record with, for each of its fields, the slice of places that the field takes."""
    stops, values = 0, []
    for _, kind in _fields(record):
        start, stops = stops, stops + (size(kind) if _is_record(kind) else 1)
        values.append(slice(start, stops))
    return record(*values)


def in_block(place: int) -> str:
    """Address a block: rows of `BLOCK` numbers below each other in a flat array; `at` is the lane in the block."""
    return f"array[{place * BLOCK} + at]"


def in_rows(place: int) -> str:
    """Address an array (numbers of the record, lanes); `at` is the lane."""
    return f"array[{place}, at]"


def in_columns(place: int) -> str:
    """Address an array (rows, numbers of the record); `at` is the row."""
    return f"array[at, {place}]"


def in_list(place: int) -> str:
    """Address a sequence; `at` is the place of the record's first number."""
    return f"array[at + {place}]"


def reader(record: type, address: Callable[[int], str], where: Any = None) -> Any:
    """Return a compiled function ``read(array, at)`` that returns a record.

    Args:
        record: what is read.
        address: how the array is addressed: `in_block`, `in_rows`, `in_columns` or `in_list`.
        where: the `places` of its numbers, a part of those of a larger record; None: the first ones.
    """
    names: dict[str, Any] = {}

    def expression(kind: type, place: Any) -> str:
        if not _is_record(kind):
            return address(place)
        names[kind.__name__] = kind
        parts = (expression(part, at) for (_, part), at in zip(_fields(kind), place, strict=True))
        return f"{kind.__name__}({', '.join(parts)})"

    return _defined(f"def read(array, at):\n    return {expression(record, where or places(record))}\n", names)


def writer(record: type, address: Callable[[int], str], where: Any = None) -> Any:
    """Return a compiled function ``write(array, at, record)``; arguments as for `reader`."""

    def lines(kind: type, place: Any, value: str) -> Iterator[str]:
        if not _is_record(kind):
            yield f"    {address(place)} = {value}\n"
            return
        for (name, part), at in zip(_fields(kind), place, strict=True):
            yield from lines(part, at, f"{value}.{name}")

    body = "".join(lines(record, where or places(record), "record"))
    return _defined(f"def write(array, at, record):\n{body}", {})


def _defined(source: str, names: dict[str, Any]) -> Any:
    """Return the one function that a source defines, for use in compiled code."""
    defined: dict[str, Any] = {}
    exec(source, names, defined)
    (function,) = defined.values()
    return register_jitable(forceinline=True)(function)


def _fields(record: type) -> list[tuple[str, Any]]:
    """Return names and types of the fields, in order."""
    kinds = typing.get_type_hints(record)
    return [(name, kinds[name]) for name in record._fields]  # type: ignore[attr-defined]


def _is_record(kind: Any) -> bool:
    return hasattr(kind, "_fields")
