"""Records: those with an entry for each joint, where numbers stand in arrays, and compiled functions of them.

A record is a NamedTuple whose fields are numbers or further records. In an array its numbers stand one after the
other in the order of the fields, so every offset follows from the declaration of the record, here and nowhere else:

    class Load(NamedTuple):
        torque: PerJoint
        mass: Any

    size(Load)                         # 3
    places(Load).mass                  # 2
    columns(Load).torque               # slice(0, 2)
    read = reader(Load, in_columns)    # read(table, k) returns Load(PerJoint(table[k, 0], table[k, 1]), table[k, 2])

How many joints an arm has is said once, to `per_joint` and `point`: records and functions are made from what they
return. Readers, writers and the functions of `joint_by_joint` and `over_joints` are generated as source, as
`dataclasses` does it: written-out constant indices are what lets the compiler keep a record in registers and turn a
loop over lanes into SIMD code.
"""

from __future__ import annotations

import functools
import typing
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from numba.extending import register_jitable

__all__ = [
    "BLOCK", "JOINTS", "PerJoint", "Point", "State", "columns", "flat", "in_block", "in_blocks", "in_columns",
    "in_list", "in_rows", "joint_by_joint", "over_joints", "per_joint", "places", "point", "reader", "record_type",
    "size", "state_record", "writer",
]  # fmt: skip

BLOCK = 32
"""Lanes that are advanced together: their numbers stay in the fastest cache."""


class PerJoint(NamedTuple):
    """One number for each joint of the arm with two; `per_joint` has the record of any number of them."""

    joint1: Any
    joint2: Any


JOINTS = len(PerJoint._fields)
"""How many joints the paper's arm has."""


class Point(NamedTuple):
    """A vector in the plane of the two-joint arm, x points down, y to the right; `point` has the one in space."""

    x: Any
    y: Any


class State(NamedTuple):
    """Motor and link angles [rad], then their velocities [rad/s], of the arm with two joints; see `state_record`."""

    motor: PerJoint
    link: PerJoint
    motor_velocity: PerJoint
    link_velocity: PerJoint


def record_type(name: str, **fields: Any) -> Any:
    """Return a record with these fields, each a number (``Any``) or a record."""
    return NamedTuple(name, list(fields.items()))


@functools.cache
def per_joint(joints: int) -> Any:
    """Return the record of one number for each joint, joint1, joint2, ...; always the same, `PerJoint` for two."""
    if joints == len(PerJoint._fields):
        return PerJoint
    return record_type("PerJoint", **{f"joint{k + 1}": Any for k in range(joints)})


@functools.cache
def point(axes: int) -> Any:
    """Return the record of a vector with 2 or 3 axes, x, y and z; always the same class, for two `Point`."""
    return Point if axes == len(Point._fields) else record_type("Point", **dict.fromkeys("xyz"[:axes], Any))


@functools.cache
def state_record(joints: int) -> Any:
    """Return `State` for a number of joints; always the same class."""
    if joints == len(PerJoint._fields):
        return State
    return record_type("State", **dict.fromkeys(State._fields, per_joint(joints)))


@functools.cache
def joint_by_joint(function: Callable[..., Any], kind: Any, arguments: int, shared: int = 0) -> Any:
    """Return the compiled function that gives the record of what `function` gives for each field of its arguments.

    ``joint_by_joint(f, PerJoint, 2, 1)(a, b, s)`` is ``PerJoint(f(a.joint1, b.joint1, s), f(a.joint2, b.joint2, s))``;
    so for points and their axes.

    Args:
        function: elementwise.
        kind: the record of the arguments and of the result.
        arguments: how many there are.
        shared: how many numbers follow, the same for each field.
    """
    source = f"return {kind.__name__}({', '.join(_calls(kind, arguments, shared))})"
    return _defined_for(source, arguments + shared, {"function": function, kind.__name__: kind})


@functools.cache
def over_joints(function: Callable[..., Any], kind: Any, arguments: int, between: str = "+") -> Any:
    """Return the compiled function that adds up what `function` gives for each field of its arguments, in order.

    ``over_joints(f, PerJoint, 2, "&")(a, b)`` is ``f(a.joint1, b.joint1) & f(a.joint2, b.joint2)``.
    """
    source = f"return {f' {between} '.join(_calls(kind, arguments, 0))}"
    return _defined_for(source, arguments, {"function": function})


def _calls(kind: Any, arguments: int, shared: int) -> Iterator[str]:
    """Return the source of one call for each field."""
    for field in kind._fields:
        own = [f"a{k}.{field}" for k in range(arguments)]
        yield f"function({', '.join(own + [f'a{arguments + k}' for k in range(shared)])})"


def _defined_for(source: str, arguments: int, names: dict[str, Any]) -> Any:
    """Return the function of so many arguments, a0, a1, ..., that does what one line says."""
    return _defined(f"def apply({', '.join(f'a{k}' for k in range(arguments))}):\n    {source}\n", names)


@functools.cache
def size(kind: Any) -> int:
    """Return how many numbers a record has."""
    return sum(size(part) if _is_record(part) else 1 for _, part in _fields(kind))


def flat(record: Any) -> list[Any]:
    """Return the numbers of a record, in order."""
    return [number for part in record for number in (flat(part) if isinstance(part, tuple) else [part])]


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


def in_blocks(place: int) -> str:
    """Address an array (blocks, numbers of the record, `BLOCK`); `at` is the lane, counted through all blocks."""
    return f"array[at // {BLOCK}, {place}, at % {BLOCK}]"


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
        address: how the array is addressed: `in_block`, `in_blocks`, `in_rows`, `in_columns` or `in_list`.
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
    return _compiled(source, tuple(names.items()))


@functools.cache
def _compiled(source: str, names: tuple[tuple[str, Any], ...]) -> Any:
    """Return the function; the same one again for the same source, so that it is compiled once."""
    defined: dict[str, Any] = {}
    exec(source, dict(names), defined)
    (function,) = defined.values()
    return register_jitable(forceinline=True)(function)


@functools.cache
def _fields(record: type) -> tuple[tuple[str, Any], ...]:
    """Return names and types of the fields, in order."""
    kinds = typing.get_type_hints(record)
    return tuple((name, kinds[name]) for name in record._fields)  # type: ignore[attr-defined]


def _is_record(kind: Any) -> bool:
    return hasattr(kind, "_fields")
