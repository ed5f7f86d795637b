"""Recording: a function is run on symbols, and its computations become a program in which each operation occurs once.

A `Program` has nested regions: the top, and within it those of loops and branches. An operation whose operands precede
a loop is placed before the loop; an operation in a branch stays there. Symbols that depend only on constants are
*uniform*: one number for all arms.
"""

import contextlib
import itertools
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from fuzzyarm.numbers.functions import KINDS, RECORDERS, Cells, flat, like
from fuzzyarm.numbers.symbols import Array, Branch, For, Index, Loop, Region, Store, Symbol, Table, Word

__all__ = ["Program"]


class Program:
    """A recorded function ``f(*ports, constants, *tables)`` that returns as many ports.

    A port is a tree of numbers that differ between arms. Each returned number is stored in place of the corresponding
    given number, unless it is returned unchanged.

    Attributes:
        ports: number of entries of each port; `arrays`: sizes of the program's own arrays.
        constants: the symbols of the constants, which are the same for all arms.
        tables: the shape of each table; it begins with 0 where a kernel is given the number of rows.
        cells: the indices of array entries among the numbers of all ports.
        top: the region that contains all others; `now`: the region that is being recorded into.
        inputs: the symbols of all ports, in order; `outputs`: the returned numbers, in the same order.
    """

    def __init__(
        self,
        function: Callable[..., Sequence[Any]],
        ports: Sequence[Any],
        constants: Any = (),
        tables: Iterable[tuple[int, ...]] = (),
    ) -> None:
        """Record the function.

        Only the structure of port trees matters; their `Cells` become arrays, which the function changes in place.
        Constants are a tree without `Cells`. Tables are given by their shapes, with 0 for any number of rows.
        ValueError if the sizes of the returned ports differ from the given ones.
        """
        self.count, self.top, self.tables = 0, Region(None), tuple(tables)
        self.now, self.ports = self.top, tuple(len(flat(port)) for port in ports)
        self.arrays, self.cells, self.loops = list[int](), set[int](), 0
        self.inputs = [Symbol(self, "input", detail=place) for place in range(sum(self.ports))]
        self.constants = [Symbol(self, "shared", uniform=True, detail=k) for k in range(len(flat(constants)))]
        given, shared = iter(self.inputs), like(constants, iter(self.constants))
        looked_up = [Table(self, number, shape) for number, shape in enumerate(self.tables)]

        def held(cells: Cells) -> Array:
            places = [next(given).detail for _ in range(cells.size)]
            self.cells.update(places)
            return Array(self, "room", places[0] if places else 0, cells.shape)

        own = [like(port, given, held) for port in ports]
        RECORDERS.append(self)
        try:
            results = function(*own, shared, *looked_up)
        finally:
            RECORDERS.pop()
        outputs = [self._outputs(port) for port in results]
        counts = tuple(map(len, outputs))
        if counts != self.ports:
            raise ValueError(f"the function returns outputs of sizes {counts}; the sizes must be {self.ports}")
        self.outputs = list(itertools.chain(*outputs))
        self._reachable(self.outputs)

    def _outputs(self, tree: Any) -> list[Any]:
        """Return, in order, the numbers of a tree that the function returned for a port."""
        if isinstance(tree, tuple):
            return [number for part in tree for number in self._outputs(part)]
        if not isinstance(tree, Array):
            return [tree]
        if tree.memory != "room":
            raise TypeError("a function that returns an array must return one of its arguments, changed in place")
        size = Cells(tree.shape).size
        return list(self.inputs[tree.first.constant : tree.first.constant + size])

    def array(self, shape: tuple[int, ...]) -> Array:
        """Return a new array in the program's own memory, see `functions.array`."""
        self.arrays.append(Cells(shape).size)
        return Array(self, f"array{len(self.arrays) - 1}", 0, shape)

    def each(self, count: Any) -> Iterator[Index]:
        """Record a loop, see `functions.each`."""
        self.loops += 1
        number = self.loops
        with self.within(loop=True) as region:
            yield Index({number: 1}, 0)
        self.now.items.append(For(number, Index.of(count), region))  # after the operations moved out of it

    @contextlib.contextmanager
    def within(self, *, loop: bool = False) -> Iterator[Region]:
        """Record into a new region within the current one, and yield it; `loop`: whether it is a loop's body.

        The caller must then add it to the items of the outer region.
        """
        outside, self.now = self.now, Region(self.now, loop=loop)
        try:
            yield self.now
        finally:
            self.now = outside

    def load(self, memory: str, place: Index) -> Symbol:
        """Record the load of an entry of an array or a table; return the symbol of the entry."""
        fixed = memory.startswith("table") and not place.terms
        operation = self.operation if fixed else self.moved
        return operation("load", detail=(memory, place.constant, tuple(sorted(place.terms.items()))))

    def moved(self, operation: str, detail: Any) -> Symbol:
        """Record an operation, with `detail` as in `Symbol`, and return its symbol.

        The operation depends on earlier writes, so it stays at this place and replaces no equal operation.
        """
        symbol = Symbol(self, operation, (), self.now, detail=detail)
        self.now.items.append(symbol)
        return symbol

    def store(self, memory: str, place: Index, value: Any) -> None:
        """Record that a number is written to an array."""
        value = self._real(value)
        self._reachable((value,))
        self.now.items.append(Store(memory, place, value))

    def _reachable(self, operands: Iterable[Any]) -> None:
        for one in operands:
            if isinstance(one, Symbol) and not self.now.within(one.region):
                raise TypeError("a number computed inside a loop or a branch is used outside it; store it in an array")

    def operation(self, operation: str, *operands: Any, kind: str = "real", detail: Any = None) -> Symbol:
        """Return the symbol of an operation; record the operation unless its result is already available."""
        if any(isinstance(one, Symbol) and one.kind == "word" for one in operands):
            if operation not in _OF_WORDS:
                raise TypeError(f"the operation {operation!r} is not available for 64-bit words")
            operands = tuple(one if isinstance(one, Symbol) else Word(one) for one in operands)
            kind = "real" if operation in ("number", "bits") else "word"
        elif operation in _ARITHMETIC:
            operands = tuple(self._real(one) for one in operands)
            if operation == "*" and 1.0 in [one for one in operands if not isinstance(one, Symbol)]:
                return next(one for one in operands if isinstance(one, Symbol))
        self._reachable(operands)
        uniform = operation not in ("row", "entry") and all(
            not isinstance(one, Symbol) or one.uniform for one in operands
        )
        region = self.top if uniform else self.now
        kept = operation == "entry" and bool(detail[2])  # its column depends on loops
        while (
            region.loop
            and not kept
            and not any(isinstance(one, Symbol) and one.region.within(region) for one in operands)
        ):
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
        """Return a boolean as 1.0 or 0.0, and other operands unchanged."""
        return self.operation("real", operand) if isinstance(operand, Symbol) and operand.kind == "truth" else operand

    def size(self) -> int:
        """Return the number of operations and stores, including those in nested regions."""

        def count(region: Region) -> int:
            return sum(
                count(item.region) if hasattr(item, "region") and not isinstance(item, Symbol) else 1
                for item in region.items
            )

        return count(self.top)


_ARITHMETIC = {"+", "-", "*", "/"}
_OF_WORDS = {"+", "*", "xor", "shift", "select", "number", "bits"}


def _key(operand: Any) -> Any:
    if isinstance(operand, Symbol):
        return operand.number
    return ("word", int(operand)) if isinstance(operand, Word) else struct.pack("d", operand)


class _Symbols:
    """The functions of the module `functions` for symbols: they record operations in a program."""

    @staticmethod
    def select(condition: Symbol, first: Any, second: Any) -> Any:
        if first is second:
            return first
        kind = first.kind if isinstance(first, Symbol) else "real"
        return condition.program.operation("select", condition, first, second, kind=kind)

    @staticmethod
    def row(table: Table, place: Symbol) -> list[Symbol]:
        return [place.program.operation("row", place, detail=(table, k)) for k in range(table.columns)]

    @staticmethod
    def entry(table: Table, place: Symbol, column: Any) -> Symbol:
        index = Index.of(column)
        detail = table, index.constant, tuple(sorted(index.terms.items()))
        return place.program.operation("entry", place, detail=detail)

    floor = staticmethod(lambda x: x.program.operation("floor", x))
    word = staticmethod(lambda x: x.program.operation("word", x, kind="word"))
    whole = staticmethod(lambda x: x.program.operation("whole", x, kind="word"))
    number = staticmethod(lambda word: word.program.operation("number", word))
    bits = staticmethod(lambda word: word.program.operation("bits", word))

    @staticmethod
    def repeat(count: Any, function: Callable[[Any], Any], carried: Any) -> Any:
        start = flat(carried)
        program = next(one.program for one in start if isinstance(one, Symbol))
        with program.within(loop=True) as region:
            inside = [Symbol(program, "carried", region=region) for _ in start]
            end = flat(function(like(carried, iter(inside))))
        after = [Symbol(program, "after", region=program.now) for _ in start]
        program.now.items.append(Loop(count, region, start, inside, end, after))
        return like(carried, iter(after))

    @staticmethod
    def only(condition: Symbol) -> Iterator[None]:
        with condition.program.within() as region:
            yield None
        condition.program.now.items.append(Branch(condition, region, [], [], []))

    @staticmethod
    def when(condition: Symbol, function: Callable[[], Any], otherwise: Any) -> Any:
        program, other = condition.program, flat(otherwise)
        with program.within() as region:
            then = flat(function())
        after = [Symbol(program, "after", region=program.now) for _ in other]
        program.now.items.append(Branch(condition, region, then, other, after))
        return like(otherwise, iter(after))


class _Indices:
    """The functions of the module `functions` for indices."""

    @staticmethod
    def number(index: Index) -> Symbol:
        return RECORDERS[-1].moved("index", (index.constant, tuple(sorted(index.terms.items()))))  # type: ignore[no-any-return]


KINDS[Symbol] = _Symbols
KINDS[Index] = _Indices
