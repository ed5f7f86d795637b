"""Symbols: the unknown numbers of a function while it is recorded, and the parts of the recorded program.

Indices of arrays and tables may depend on the iterations of loops. A program consists of regions, loops, branches,
operations and stores.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from fuzzyarm.numbers.program import Program

__all__ = ["Array", "Branch", "For", "Index", "Loop", "Region", "Store", "Symbol", "Table", "Word"]


class Word(int):
    """A constant of 64 bits, with its own type so that it is not mistaken for a float."""


class Symbol:
    """A number, boolean or 64-bit word that a program computes.

    Attributes:
        number: counts the symbols from 1, in the order of recording.
        operation: "+", "select", "input", "row", ..., on `operands`, symbols and floats, in the region `region`.
        kind: "real", "truth" or "word".
        uniform: whether the symbol has the same value for all arms.
        detail: for an input, its index; for a row, table and column; for others, further data that define them.
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
        self.program, self.operation, self.operands = program, operation, operands
        self.region, self.kind, self.uniform, self.detail = region or program.top, kind, uniform, detail
        program.count += 1
        self.number = program.count

    def __bool__(self) -> bool:
        """Raise TypeError: the value is not known while a function is recorded."""
        raise TypeError("a compiled function cannot branch on a number that it computes; use select or when instead")


def _recorded(operation: str, *, swapped: bool = False, kind: str = "real", text: str = "") -> Callable[..., Symbol]:
    def method(self: Symbol, *other: Any) -> Symbol:
        return self.program.operation(operation, *((*other, self) if swapped else (self, *other)), kind=kind)

    method.__doc__ = text
    return method


for _name in ("neg", "abs", "floor"):
    setattr(Symbol, f"__{_name}__", _recorded(_name))
for _name, _operation in {"xor": "xor", "rshift": "shift"}.items():
    setattr(Symbol, f"__{_name}__", _recorded(_operation, kind="word"))
for _name, _operation in {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}.items():
    setattr(Symbol, f"__{_name}__", _recorded(_operation))
    setattr(Symbol, f"__r{_name}__", _recorded(_operation, swapped=True))
for _name, _operation in {
    "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!=", "and": "&", "or": "|", "invert": "not",
}.items():  # fmt: skip
    setattr(Symbol, f"__{_name}__", _recorded(_operation, kind="truth"))
_FUNCTIONS = {"rint": "nearest whole number, the even one of two", "sqrt": "square root", "log": "natural logarithm"}
for _name, _result in _FUNCTIONS.items():
    setattr(Symbol, _name, _recorded(_name, text=f"Return the {_result}; `numpy.{_name}` calls this."))


class Index:
    """A whole number: `constant` plus, for each loop in `terms`, a factor times the number of the loop's iteration."""

    __slots__ = ("constant", "terms")

    def __init__(self, terms: dict[int, int], constant: int) -> None:
        self.terms, self.constant = terms, constant

    @classmethod
    def of(cls, number: Any) -> Index:
        """Return a whole number as an index."""
        return number if isinstance(number, cls) else cls({}, int(number.__index__()))

    def __add__(self, other: Any) -> Index:
        other = Index.of(other)
        loops = self.terms | other.terms
        terms = {loop: self.terms.get(loop, 0) + other.terms.get(loop, 0) for loop in loops}
        return Index(terms, self.constant + other.constant)

    def __mul__(self, factor: int) -> Index:
        return Index({loop: factor * own for loop, own in self.terms.items()}, factor * self.constant)

    def __neg__(self) -> Index:
        return self * -1

    def __sub__(self, other: Any) -> Index:
        return self + -Index.of(other)

    def __rsub__(self, other: Any) -> Index:
        return Index.of(other) + -self

    __radd__, __rmul__ = __add__, __mul__


class Array:
    """An array in an arm's memory, or a table. Reading or assigning an entry by index is recorded in the program.

    `memory` is "room" (the ports' numbers), "table0", ..., or "array0", ... (the program's own arrays). The index of
    the first entry in this memory is `first`. `steps` are the strides, in entries, by default in row-major order.
    """

    __slots__ = ("first", "memory", "program", "shape", "steps")

    def __init__(
        self, program: Program, memory: str, first: Any, shape: tuple[int, ...], steps: tuple[int, ...] | None = None
    ) -> None:
        self.program, self.memory, self.first, self.shape = program, memory, Index.of(first), shape
        if steps is None:
            steps = tuple(itertools.accumulate((1, *shape[:0:-1]), operator.mul))[::-1]
        self.steps = steps

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[Any]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, key: Any) -> Any:
        first, shape, steps = self._place(key)
        if shape:
            return Array(self.program, self.memory, first, shape, steps)
        return self.program.load(self.memory, first)

    def __setitem__(self, key: Any, value: Any) -> None:
        first, shape, _ = self._place(key)
        if shape or self.memory.startswith("table"):
            raise TypeError("only a single number can be assigned to an entry of an array; tables are read-only")
        self.program.store(self.memory, first, value)

    def _place(self, key: Any) -> tuple[Index, tuple[int, ...], tuple[int, ...]]:
        """Return the index of the first entry that `key` selects, and the shape and strides of the selection."""
        keys = key if isinstance(key, tuple) else (key,)
        first, shape, steps = self.first, list[int](), list[int]()
        for axis, size in enumerate(self.shape):
            one, step = keys[axis] if axis < len(keys) else slice(None), self.steps[axis]
            if isinstance(one, slice):
                start, stop, _ = one.indices(size)
                first = first + start * step
                shape.append(stop - start)
                steps.append(step)
            else:
                if not isinstance(one, Index) and not 0 <= one < size:
                    raise IndexError(f"index {one} is out of range; allowed: 0 to {size - 1}")
                first = first + one * step
        return first, tuple(shape), tuple(steps)


class Table(Array):
    """A table of a program; if `shape` begins with 0, the kernel is given the number of rows."""

    __slots__ = ("columns", "number")

    def __init__(self, program: Program, number: int, shape: tuple[int, ...]) -> None:
        super().__init__(program, f"table{number}", 0, shape)
        self.number, self.columns = number, shape[-1]


class Region:
    """A sequence of `items`: operations, loops and branches; `known` maps keys to operations, for reuse."""

    def __init__(self, parent: Region | None, *, loop: bool = False) -> None:
        self.parent, self.loop, self.items, self.known = parent, loop, [], {}  # type: ignore[var-annotated]

    def within(self, other: Region) -> bool:
        """Return whether this region is `other` or lies within it."""
        at: Region | None = self
        while at is not None and at is not other:
            at = at.parent
        return at is not None


class For(NamedTuple):
    """A loop: the number that identifies it, the number of iterations, and the region that each iteration runs."""

    number: int
    rounds: Index
    region: Region


class Store(NamedTuple):
    """A write of a number to memory."""

    memory: str
    place: Index
    value: Any


class Loop(NamedTuple):
    """A region run `count` times. Each run computes `end` from `inside`, the whole loop `after` from `start`."""

    count: Any
    region: Region
    start: list[Any]
    inside: list[Symbol]
    end: list[Any]
    after: list[Symbol]


class Branch(NamedTuple):
    """A region that is run if the condition holds, and the numbers that result in either case."""

    condition: Any
    region: Region
    then: list[Any]
    otherwise: list[Any]
    after: list[Symbol]
