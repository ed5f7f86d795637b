"""What a program consists of beside operations: regions, loops, branches, and what is written into memory."""

from __future__ import annotations

from typing import Any, NamedTuple

from fuzzyarm.numbers.symbols import Index, Symbol

__all__ = ["Branch", "For", "Loop", "Region", "Store"]


class Region:
    """A sequence of operations, loops and branches.

    Attributes:
        parent: the region that it stands in; None for the top.
        loop: whether it is the body of a loop.
        items: what it holds, in order.
        known: its operations by what they compute.
    """

    def __init__(self, parent: Region | None, *, loop: bool = False) -> None:
        """Begin with nothing."""
        self.parent, self.loop, self.items, self.known = parent, loop, [], {}  # type: ignore[var-annotated]

    def within(self, other: Region) -> bool:
        """Return whether this region is `other` or stands in it."""
        at: Region | None = self
        while at is not None and at is not other:
            at = at.parent
        return at is not None


class For(NamedTuple):
    """A region that is run for each round of a loop, the loop's number, and how many rounds there are."""

    number: int
    rounds: Index
    region: Region


class Store(NamedTuple):
    """A number that is written into memory at a place."""

    memory: str
    place: Index
    value: Any


class Loop(NamedTuple):
    """A region that is run `count` times with carried numbers: at its start, inside, at its end, and after all."""

    count: Any
    region: Region
    start: list[Any]
    inside: list[Symbol]
    end: list[Any]
    after: list[Symbol]


class Branch(NamedTuple):
    """A region that is run if the condition holds, and what numbers are after it in either case."""

    condition: Any
    region: Region
    then: list[Any]
    otherwise: list[Any]
    after: list[Symbol]
