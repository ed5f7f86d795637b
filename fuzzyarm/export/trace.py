"""Numbers that are not known yet, and the program that computes them: what an export writes down.

A `Value` is a number, a whole number or a truth value that depends on the observation or the memory. Arithmetic with it
is not done but recorded, an operation a `Step`, in the order in which it is asked for; nothing is rearranged, and only
operations between known numbers are done at once. The steps are in blocks: a branch on a value has two of them.

What cannot be exported, as exceptions.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from fuzzyarm.numbers.functions import KINDS, flat, like

__all__ = [
    "LARGEST",
    "UNKNOWN",
    "Block",
    "Branch",
    "Function",
    "Kind",
    "Loops",
    "Matrix",
    "Scalar",
    "Step",
    "TooLarge",
    "Trace",
    "Unsupported",
    "Value",
    "is_number",
    "kind_of",
]  # fmt: skip


class Unsupported(ValueError):
    """A law is written with something that cannot be exported; the message says what, and where."""


class TooLarge(Unsupported):
    """A program has more numbers in its tables than is allowed."""


LARGEST = 2**18
"""Numbers that all tables of a program may have: 2 MiB in double precision."""


class Kind(enum.StrEnum):
    """What a value is."""

    REAL = "real"
    WHOLE = "whole"
    TRUTH = "truth"


@dataclasses.dataclass(eq=False)
class Step:
    """One operation: results from operands.

    Attributes:
        operation: "+", "<", "select", "input", ..., or "call" of a function.
        operands: values and numbers.
        results: the values that it defines.
        detail: the name of what is called, read or looked up.
    """

    operation: str
    operands: tuple[Scalar, ...]
    results: tuple[Value, ...] = ()
    detail: str = ""


class Matrix(NamedTuple):
    """A table of the program by its name, and how many numbers a row has."""

    name: str
    columns: int


@dataclasses.dataclass(eq=False)
class Loops(Step):
    """A call of a function of arrays, whose loops stay loops: the results are the entries of what it changes.

    Attributes:
        arrays: its arguments: a matrix, or the entries of a vector.
        changed: of each argument, whether the function changes it.
    """

    arrays: tuple[Matrix | list[Scalar], ...] = ()
    changed: tuple[bool, ...] = ()


@dataclasses.dataclass(eq=False)
class Branch:
    """Two blocks of which one is executed, and the values that both define.

    Attributes:
        condition: the truth value.
        then, otherwise: the block if it is true, and the one if it is not.
        merged: of each value defined after the branch, it and what it is after either block.
    """

    condition: Value
    then: Block
    otherwise: Block
    merged: list[tuple[Value, Scalar, Scalar]] = dataclasses.field(default_factory=list)


Block: TypeAlias = list[Step | Branch]
"""Operations and branches in the order in which they are executed."""


@dataclasses.dataclass(eq=False)
class Function:
    """A function of the exported program: scalars in, scalars out.

    Attributes:
        name: in the program.
        parameters: its arguments.
        body: what it does.
        results: what it returns.
    """

    name: str
    parameters: tuple[Value, ...]
    body: Block
    results: tuple[Scalar, ...]


class Value:
    """A number that is known only when the exported program runs.

    Attributes:
        kind: whether it is a real number, a whole number or a truth value.
        name: what the law's source calls it; empty: nothing.
    """

    __slots__ = ("_trace", "kind", "name")
    __hash__ = object.__hash__

    def __init__(self, trace: Trace, kind: Kind, name: str = "") -> None:
        """Make a value of a trace."""
        self._trace, self.kind, self.name = trace, kind, name

    def __bool__(self) -> bool:
        """Refuse to branch."""
        raise Unsupported(
            "the law branches on a number that is not known; use select, when or only of fuzzyarm.numbers"
        )

    def _with(self, operation: str, other: Any, *, swapped: bool = False, truth: bool = False) -> Any:
        if not (isinstance(other, Value) or is_number(other)):
            return NotImplemented
        pair = (other, self) if swapped else (self, other)
        if truth:
            return self._trace.operation(operation, *pair, kind=Kind.TRUTH)
        return self._trace.arithmetic(operation, *pair)

    def __floor__(self) -> Value:
        """Record the largest whole number that is not above x."""
        return self._trace.operation("floor", self, kind=Kind.REAL)

    def rint(self) -> Value:
        """Record the nearest whole number."""
        return self._trace.operation("rint", self, kind=Kind.REAL)

    def sqrt(self) -> Value:
        """Record the square root."""
        return self._trace.operation("sqrt", self, kind=Kind.REAL)

    def __neg__(self) -> Value:
        """Record -x."""
        return self._trace.operation("neg", self, kind=self.kind)

    def __abs__(self) -> Value:
        """Record |x|."""
        return self._trace.operation("abs", self, kind=self.kind)

    def __invert__(self) -> Value:
        """Record that x is not true."""
        return self._trace.operation("not", self, kind=Kind.TRUTH)


def _recorded(operation: str, *, swapped: bool = False, truth: bool = False) -> Callable[[Value, Any], Any]:
    def method(self: Value, other: Any) -> Any:
        return self._with(operation, other, swapped=swapped, truth=truth)

    return method


for _name, _operation in {"add": "+", "sub": "-", "mul": "*", "truediv": "/", "mod": "%"}.items():
    setattr(Value, f"__{_name}__", _recorded(_operation))
    setattr(Value, f"__r{_name}__", _recorded(_operation, swapped=True))
for _name, _operation in {"and": "&&", "or": "||"}.items():
    setattr(Value, f"__{_name}__", _recorded(_operation, truth=True))
    setattr(Value, f"__r{_name}__", _recorded(_operation, swapped=True, truth=True))
for _name, _operation in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}.items():
    setattr(Value, f"__{_name}__", _recorded(_operation, truth=True))

Scalar: TypeAlias = Value | float | int | bool
"""A value, or a known number."""


def is_number(value: Any) -> bool:
    """Return whether something is a known number or truth value."""
    return isinstance(value, bool | int | float | np.number | np.bool_)


class Trace:
    """The program so far.

    Attributes:
        block: where the next step goes.
        functions: what the program calls, by name, in the order of definition.
        tables: constant arrays (rows, numbers of a row) that are looked up in, by name.
        arrays: those that are written by index, which a branch may change.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self.block: Block = []
        self.functions: dict[str, Function] = {}
        self.tables: dict[str, np.ndarray] = {}
        self.arrays: list[np.ndarray] = []
        self._shapes: dict[str, Any] = {}  # what the functions return

    def array(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return an array of a shape, whose entries are not known, see `numbers.functions.array`."""
        self.arrays.append(np.full(shape, UNKNOWN, dtype=object))
        return self.arrays[-1]

    def each(self, count: int) -> range:
        """Return the rounds of a loop, which is written out."""
        return range(count)

    def apart(self, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
        """Return what a function of the program gives; its arguments and results are numbers, or records of them."""
        numbers, name = flat(tuple(arguments)), function.__name__
        if not any(isinstance(argument, Value) for argument in numbers):
            return function(*arguments)
        if name not in self.functions:
            outside, self.block = self.block, []
            names = list(inspect.signature(function).parameters)
            given = [self._unknown(argument, own) for argument, own in zip(arguments, names, strict=True)]
            arrays, self.arrays = self.arrays, []
            self._shapes[name] = result = function(*given)
            self.arrays = arrays
            self.functions[name] = Function(name, tuple(flat(tuple(given))), self.block, tuple(flat((result,))))
            self.block = outside
        return like(self._shapes[name], iter(self.call(self.functions[name], numbers)))

    def _unknown(self, argument: Any, name: str) -> Any:
        """Return a value for a number, or one for each number of a record."""
        if not isinstance(argument, tuple):
            return Value(self, Kind.REAL, name)
        parts = argument._asdict() if hasattr(argument, "_asdict") else dict(enumerate(argument))
        values = [self._unknown(part, f"{name}_{own}") for own, part in parts.items()]
        return type(argument)(*values) if hasattr(argument, "_asdict") else tuple(values)

    def operation(self, name: str, *operands: Scalar, kind: Kind, detail: str = "") -> Value:
        """Record an operation with one result and return that."""
        result = Value(self, kind)
        self.block.append(Step(name, operands, (result,), detail))
        return result

    def arithmetic(self, name: str, first: Scalar, second: Scalar) -> Scalar:
        """Record +, -, *, / or %; whole numbers stay whole but for /. Of whole ones 0 + x, x - 0 are x, of real 1 x."""
        whole = all(kind_of(operand) is Kind.WHOLE for operand in (first, second)) and name != "/"
        if name == "*" and not whole:
            for one, other in ((first, second), (second, first)):
                if is_number(one) and one == 1.0 and kind_of(other) is Kind.REAL:
                    return other
        if whole and name in ("+", "-") and is_number(zero := first if name == "+" else second) and zero == 0:
            return second if name == "+" else first
        if name == "%" and not whole:
            raise Unsupported("the remainder of a number that is not whole")
        return self.operation(name, first, second, kind=Kind.WHOLE if whole else Kind.REAL)

    def call(self, function: Function, operands: Sequence[Scalar]) -> tuple[Value, ...]:
        """Record the call of a function and return its results."""
        kinds = [kind_of(result) for result in function.results]
        results = tuple(Value(self, kind) for kind in kinds)
        self.block.append(Step("call", tuple(operands), results, function.name))
        return results

    def rolled(self, name: str, arrays: Sequence[np.ndarray], written: Sequence[bool]) -> None:
        """Record the call of a function of arrays that keeps its loops, and fill what it writes with values.

        Constant matrices (rows, columns) become tables, other arrays (size,) are given entry by entry.
        """
        given: list[Matrix | list[Scalar]] = []
        results: list[Value] = []
        for array, changes in zip(arrays, written, strict=True):
            given.append(list(array) if array.ndim == 1 else Matrix(self.table(array, "weights"), array.shape[1]))
            if changes:
                array[:] = [Value(self, Kind.REAL) for _ in array]
                results.extend(array)
        operands = tuple(entry for entries in given if isinstance(entries, list) for entry in entries)
        self.block.append(Loops("loops", operands, tuple(results), name, tuple(given), tuple(written)))

    def input(self, place: str, kind: Kind = Kind.REAL, name: str = "") -> Value:
        """Record that a number is read, from a place in the program's own text, and return it."""
        value = self.operation("input", kind=kind, detail=place)
        value.name = name
        return value

    def table(self, array: np.ndarray, name: str) -> str:
        """Return the name of a table with the rows of an array (rows, ...); Unsupported if there is too much in all."""
        rows = np.asarray(array, dtype=np.float64).reshape(len(array), -1)
        for known, held in self.tables.items():
            if held.shape == rows.shape and np.array_equal(held, rows):
                return known
        numbers = rows.size + sum(held.size for held in self.tables.values())
        if numbers > LARGEST:
            raise TooLarge(f"it has {numbers} numbers in its tables or layers; allowed: {LARGEST}")
        free = name if name not in self.tables else f"{name}{len(self.tables)}"
        self.tables[free] = rows
        return free

    def merged(self, branch: Branch, first: Any, second: Any) -> Any:
        """Return what something is after a branch, from what it is after its blocks; tuples part by part."""
        if first is second or (is_number(first) and is_number(second) and _same_bits(first, second)):
            return first
        if isinstance(first, tuple) and isinstance(second, tuple) and len(first) == len(second):
            parts = [self.merged(branch, one, other) for one, other in zip(first, second, strict=True)]
            return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)
        if not all(isinstance(one, Value) or is_number(one) for one in (first, second)):
            return UNKNOWN
        kinds = {kind_of(first), kind_of(second)}
        value = Value(self, kinds.pop() if len(kinds) == 1 else Kind.REAL)
        value.name = next((one.name for one in (first, second) if isinstance(one, Value) and one.name), "")
        branch.merged.append((value, first, second))
        return value


class _Unknown:
    """What a name refers to that only one side of a branch gave a meaning; using it is an error."""

    def __repr__(self) -> str:
        return "a name that only one side of a branch defines"


UNKNOWN = _Unknown()
"""The meaning of a name that only one side of a branch defines, and of an entry that was never written."""


def _same_bits(first: Any, second: Any) -> bool:
    return kind_of(first) is kind_of(second) and repr(float(first)) == repr(float(second))


def kind_of(operand: Scalar) -> Kind:
    """Return what a value or a known number is."""
    if isinstance(operand, Value):
        return operand.kind
    if isinstance(operand, bool | np.bool_):
        return Kind.TRUTH
    return Kind.WHOLE if isinstance(operand, int | np.integer) else Kind.REAL


class _Values:
    """What values do in place of floats, see `numbers.functions`."""

    @staticmethod
    def select(condition: Value, first: Scalar, second: Scalar) -> Value:
        return condition._trace.operation("select", condition, first, second, kind=Kind.REAL)

    @staticmethod
    def floor(x: Value) -> Value:
        return x._trace.operation("floor", x, kind=Kind.REAL)

    @staticmethod
    def row(table: np.ndarray, place: Value) -> list[Value]:
        trace, name = place._trace, place._trace.table(table, "table")
        positive: Any = place > 0.0  # type: ignore[operator]
        within: Any = _Values.select(positive, place, 0.0)
        within = _Values.select(within < len(table) - 1.0, within, len(table) - 1.0)
        whole = trace.operation("whole", within, kind=Kind.WHOLE)
        return [trace.operation("lookup", whole, k, kind=Kind.REAL, detail=name) for k in range(table.shape[1])]

    @staticmethod
    def entry(table: np.ndarray, place: Value, column: int) -> Value:
        return _Values.row(table, place)[column]

    @staticmethod
    def when(condition: Value, function: Callable[[], Any], otherwise: Any) -> Any:
        trace = condition._trace
        branch, held = Branch(condition, [], []), [array.copy() for array in trace.arrays]
        outside, trace.block = trace.block, branch.then
        then = function()
        trace.block = outside
        outside.append(branch)
        for array, before in zip(trace.arrays, held, strict=False):  # those of the branch alone come behind
            for place in np.ndindex(array.shape):
                array[place] = trace.merged(branch, array[place], before[place])
        return trace.merged(branch, then, otherwise)

    @staticmethod
    def only(condition: Value) -> Iterator[None]:
        trace = condition._trace
        branch, held = Branch(condition, [], []), [array.copy() for array in trace.arrays]
        outside, trace.block = trace.block, branch.then
        yield None
        trace.block = outside
        outside.append(branch)
        for array, before in zip(trace.arrays, held, strict=False):
            for place in np.ndindex(array.shape):
                array[place] = trace.merged(branch, array[place], before[place])


KINDS[Value] = _Values
