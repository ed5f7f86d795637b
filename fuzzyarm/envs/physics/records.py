"""Records: those with an entry for each joint, and where their numbers stand in arrays.

A record is a NamedTuple whose fields are numbers or further records. In an array its numbers stand one after the
other in the order of the fields:

    class Load(NamedTuple):
        torque: PerJoint
        mass: Any

    size(Load) = 3      places(Load).mass = 2      columns(Load).torque = slice(0, 2)
    filled(Load, table[k]) = Load(PerJoint(table[k, 0], table[k, 1]), table[k, 2])
"""

from __future__ import annotations

import functools
import typing
from collections.abc import Iterable
from typing import Any, NamedTuple

from fuzzyarm.numbers.functions import flat, like

__all__ = [
    "JOINTS", "PerJoint", "Point", "State", "columns", "filled", "flat", "per_joint", "places", "point", "record_type",
    "size", "state_record",
]  # fmt: skip


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
def size(kind: Any) -> int:
    """Return how many numbers a record has."""
    return sum(size(part) if _is_record(part) else 1 for _, part in _fields(kind))


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


def filled(record: Any, numbers: Iterable[Any]) -> Any:
    """Return a record with these numbers, which stand in its order; rows of an array, for a record of arrays."""
    return like(places(record), iter(numbers))


@functools.cache
def _fields(record: type) -> tuple[tuple[str, Any], ...]:
    """Return names and types of the fields, in order."""
    kinds = typing.get_type_hints(record)
    return tuple((name, kinds[name]) for name in record._fields)  # type: ignore[attr-defined]


def _is_record(kind: Any) -> bool:
    return hasattr(kind, "_fields")
