"""Symbols: numbers that are not known while a function is recorded, and the operations on them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzyarm.numbers.program import Program
    from fuzzyarm.numbers.regions import Region

__all__ = ["Symbol", "Word"]


class Word(int):
    """A constant of 64 bits, which no float is taken for."""


class Symbol:
    """A number, a truth value or a word of 64 bits that a program computes.

    Attributes:
        program: that it belongs to.
        number: its own, from 1 in the order of recording.
        operation: "+", "select", "input", "row", ...
        operands: symbols and floats.
        region: where it is computed.
        kind: "real", "truth" or "word".
        uniform: whether it is the same for all arms.
        detail: of an input or a row, where it is found.
    """

    __slots__ = ("detail", "kind", "number", "operands", "operation", "program", "region", "uniform")
    __hash__ = object.__hash__

    def __init__(
        self,
        program: Program,
        operation: str,
        operands: tuple[Any, ...] = (),
        region: Region | None = None,
        *,
        kind: str = "real",
        uniform: bool = False,
        detail: Any = None,
    ) -> None:
        """Give it the next number."""
        self.program, self.operation, self.operands = program, operation, operands
        self.region, self.kind, self.uniform, self.detail = region or program.top, kind, uniform, detail
        program.count += 1
        self.number = program.count

    def __bool__(self) -> bool:
        """Refuse to branch."""
        raise TypeError("a branch on a number that is not known while it is recorded; use select or when")

    def __neg__(self) -> Symbol:
        return self.program.operation("neg", self)

    def __abs__(self) -> Symbol:
        return self.program.operation("abs", self)

    def __invert__(self) -> Symbol:
        return self.program.operation("not", self, kind="truth")

    def __floor__(self) -> Symbol:
        return self.program.operation("floor", self)

    def rint(self) -> Symbol:
        """Return the nearest whole number, the even one of two; `numpy.rint` asks for it."""
        return self.program.operation("rint", self)

    def sqrt(self) -> Symbol:
        """Return the square root."""
        return self.program.operation("sqrt", self)

    def log(self) -> Symbol:
        """Return the natural logarithm, by the C library."""
        return self.program.operation("log", self)

    def __xor__(self, other: Any) -> Symbol:
        return self.program.operation("xor", self, other, kind="word")

    def __rshift__(self, bits: Any) -> Symbol:
        return self.program.operation("shift", self, bits, kind="word")


def _recorded(operation: str, *, swapped: bool = False, kind: str = "real") -> Callable[[Symbol, Any], Symbol]:
    def method(self: Symbol, other: Any) -> Symbol:
        pair = (other, self) if swapped else (self, other)
        return self.program.operation(operation, *pair, kind=kind)

    return method


for _name, _operation in {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}.items():
    setattr(Symbol, f"__{_name}__", _recorded(_operation))
    setattr(Symbol, f"__r{_name}__", _recorded(_operation, swapped=True))
for _name, _operation in {
    "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!=", "and": "&", "or": "|",
}.items():  # fmt: skip
    setattr(Symbol, f"__{_name}__", _recorded(_operation, kind="truth"))
