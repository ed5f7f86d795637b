"""Recording: a function is run on symbols, and what it computes becomes a program, each operation once.

A `Program` has regions: its top, and within it loops and branches. An operation whose operands stand before a loop is
put before the loop; one in a branch stays there. What depends on constants alone is *uniform*: one number for all arms.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from fuzzyarm.numbers.functions import KINDS, flat, like

__all__ = ["Branch", "Loop", "Program", "Region", "Symbol", "Table", "Word"]


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


class Table(NamedTuple):
    """A table of a program: which one it is, and the numbers of a row; how many rows there are is said to a kernel."""

    number: int
    columns: int


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

    condition: Symbol
    region: Region
    then: list[Any]
    otherwise: list[Any]
    after: list[Symbol]


class Program:
    """A recorded function ``f(*ports, constants, *tables)`` that returns as many ports.

    A port is a tree of numbers that each arm has of its own. What the function returns in its place is stored there,
    number by number; a number that comes back as it was given is not.

    Attributes:
        ports: how many numbers each port has.
        constants: the symbols of the constants, which are the same for all arms.
        tables: the numbers of a row of each table.
        top: the region of all operations.
        inputs: the symbols of all ports, in order.
        outputs: what becomes of them, likewise.
        now: the region that is recorded into.
        count: symbols so far.
    """

    def __init__(
        self,
        function: Callable[..., Sequence[Any]],
        ports: Sequence[Any],
        constants: Any = (),
        tables: Iterable[int] = (),
    ) -> None:
        """Record.

        Args:
            function: see the class.
            ports: trees of anything, for their shapes.
            constants: a tree of anything, likewise.
            tables: the numbers of a row of each table.

        Raises:
            ValueError: the function returns ports with other counts of numbers than it takes.
        """
        self.count, self.top, self.tables = 0, Region(None), tuple(tables)
        self.now, self.ports = self.top, tuple(len(flat(port)) for port in ports)
        self.inputs = [Symbol(self, "input", detail=place) for place in range(sum(self.ports))]
        self.constants = [Symbol(self, "shared", uniform=True, detail=k) for k in range(len(flat(constants)))]
        given, shared = iter(self.inputs), like(constants, iter(self.constants))
        looked_up = [Table(number, columns) for number, columns in enumerate(self.tables)]
        results = function(*(like(port, given) for port in ports), shared, *looked_up)
        counts = tuple(len(flat(port)) for port in results)
        if counts != self.ports:
            raise ValueError(f"the function returns ports of {counts} numbers, and takes {self.ports}")
        self.outputs = [number for port in results for number in flat(port)]

    def operation(self, operation: str, *operands: Any, kind: str = "real", detail: Any = None) -> Symbol:
        """Return the symbol of an operation, which is recorded unless it is known where it is needed."""
        if any(isinstance(one, Symbol) and one.kind == "word" for one in operands):
            if operation not in _OF_WORDS:
                raise TypeError(f"{operation} is no operation of words")
            operands = tuple(one if isinstance(one, Symbol) else Word(one) for one in operands)
            kind = "real" if operation in ("number", "bits") else "word"
        elif operation in _ARITHMETIC:
            operands = tuple(self._real(one) for one in operands)
            if operation == "*" and 1.0 in [one for one in operands if not isinstance(one, Symbol)]:
                return next(one for one in operands if isinstance(one, Symbol))
        uniform = operation != "row" and all(not isinstance(one, Symbol) or one.uniform for one in operands)
        region = self.top if uniform else self.now
        while region.loop and not any(isinstance(one, Symbol) and one.region.within(region) for one in operands):
            region = region.parent  # type: ignore[assignment]
        key, look = (operation, detail, *map(_key, operands)), region
        while look is not None:
            if key in look.known:
                return look.known[key]  # type: ignore[no-any-return]
            look = look.parent  # type: ignore[assignment]
        symbol = Symbol(self, operation, operands, region, kind=kind, uniform=uniform, detail=detail)
        region.items.append(symbol)
        region.known[key] = symbol
        return symbol

    def _real(self, operand: Any) -> Any:
        """Return 1.0 or 0.0 for a truth value."""
        return self.operation("real", operand) if isinstance(operand, Symbol) and operand.kind == "truth" else operand

    def size(self) -> int:
        """Return how many operations there are."""

        def count(region: Region) -> int:
            return sum(1 if isinstance(item, Symbol) else count(item.region) for item in region.items)

        return count(self.top)


_ARITHMETIC = {"+", "-", "*", "/"}
_OF_WORDS = {"+", "*", "xor", "shift", "select", "number", "bits"}


def _key(operand: Any) -> Any:
    if isinstance(operand, Symbol):
        return operand.number
    return ("word", int(operand)) if isinstance(operand, Word) else struct.pack("d", operand)


class _Symbols:
    """What symbols do in place of floats, see `functions`."""

    @staticmethod
    def select(condition: Symbol, first: Any, second: Any) -> Any:
        if first is second:
            return first
        kind = first.kind if isinstance(first, Symbol) else "real"
        return condition.program.operation("select", condition, first, second, kind=kind)

    @staticmethod
    def floor(x: Symbol) -> Symbol:
        return x.program.operation("floor", x)

    @staticmethod
    def row(table: Table, place: Symbol) -> list[Symbol]:
        return [place.program.operation("row", place, detail=(table, k)) for k in range(table.columns)]

    @staticmethod
    def word(x: Symbol) -> Symbol:
        return x.program.operation("word", x, kind="word")

    @staticmethod
    def whole(x: Symbol) -> Symbol:
        return x.program.operation("whole", x, kind="word")

    @staticmethod
    def number(word: Symbol) -> Symbol:
        return word.program.operation("number", word)

    @staticmethod
    def bits(word: Symbol) -> Symbol:
        return word.program.operation("bits", word)

    @staticmethod
    def repeat(count: Any, function: Callable[[Any], Any], carried: Any) -> Any:
        start = flat(carried)
        program = next(one.program for one in start if isinstance(one, Symbol))
        outside = program.now
        region = Region(outside, loop=True)
        inside = [Symbol(program, "carried", region=region) for _ in start]
        program.now = region
        end = flat(function(like(carried, iter(inside))))
        program.now = outside
        after = [Symbol(program, "after", region=outside) for _ in start]
        outside.items.append(Loop(count, region, start, inside, end, after))
        return like(carried, iter(after))

    @staticmethod
    def when(condition: Symbol, function: Callable[[], Any], otherwise: Any) -> Any:
        program, other = condition.program, flat(otherwise)
        outside = program.now
        program.now = region = Region(outside)
        then = flat(function())
        program.now = outside
        after = [Symbol(program, "after", region=outside) for _ in other]
        outside.items.append(Branch(condition, region, then, other, after))
        return like(otherwise, iter(after))


KINDS[Symbol] = _Symbols
