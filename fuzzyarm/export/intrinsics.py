"""What the interpreter does itself: functions of NumPy and of Python that a law calls with values."""

from __future__ import annotations

import builtins
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzyarm.envs.physics import elementwise
from fuzzyarm.export.loops import ROLLED, written
from fuzzyarm.export.refusals import Unsupported
from fuzzyarm.export.trace import UNKNOWN, Kind, Scalar, Trace, Value, kind_of
from fuzzyarm.fuzzy_policy.lanes import in_lanes

if TYPE_CHECKING:
    from fuzzyarm.export.partial import Interpreter

__all__ = ["INTRINSICS", "METHODS", "Row", "entry_of", "holds_values"]

METHODS = ("copy",)
"""Methods of arrays whose result is an array of the law's own."""


def entry_of(trace: Trace, array: Any, place: tuple[Any, ...], name: str) -> Any:
    """Return an entry of a constant array, or a row of it, at a place (axes,) of which some numbers are not known."""
    last = max(axis for axis, index in enumerate(place) if isinstance(index, Value))
    if not isinstance(array, np.ndarray) or any(isinstance(index, slice) for index in place[: last + 1]):
        raise Unsupported("an entry at a place that is not known, of an array that is not constant")
    row: Any = 0
    for size, index in zip(array.shape, place[: last + 1], strict=False):
        row = row * size + index
    flat = Row(trace, array.reshape(-1, *array.shape[last + 1 :]), row, name)
    return flat[place[last + 1 :]] if place[last + 1 :] else flat


class Row:
    """A row of a constant array, at a place that is not known: its entries are looked up.

    Attributes:
        shape: of the row.
    """

    def __init__(self, trace: Trace, array: Any, place: Value, name: str) -> None:
        """Keep array (rows, ...) and place."""
        if not isinstance(array, np.ndarray) or array.dtype == object:
            raise Unsupported("an entry at a place that is not known, of an array that is not constant")
        self.shape = array.shape[1:]
        self._trace, self._place, self._table = trace, place, trace.table(array, name)

    def __getitem__(self, index: Any) -> Value:
        """Return an entry, for an index in the row."""
        number = int(np.ravel_multi_index(index if isinstance(index, tuple) else (index,), self.shape))
        return self._trace.operation("lookup", self._place, number, kind=Kind.REAL, detail=self._table)


def holds_values(things: Sequence[Any]) -> bool:
    """Return whether something among the arguments of a function is a value, or an array of them."""
    return any(
        isinstance(thing, Value) or (isinstance(thing, np.ndarray) and thing.dtype == object) for thing in things
    )


def _filled(entry: Any) -> Callable[..., np.ndarray]:
    def make(own: Interpreter, shape: Any, dtype: Any = None) -> np.ndarray:
        return own.array(np.full(shape, entry, dtype=object))

    return make


def _filled_like(entry: Any) -> Callable[..., np.ndarray]:
    def make(own: Interpreter, like: np.ndarray) -> np.ndarray:
        return own.array(np.full(like.shape, entry, dtype=object))

    return make


def _scalar(operation: str, kind: Kind, known: Callable[[Any], Any]) -> Callable[..., Any]:
    """Return what a function of one number does."""

    def apply(own: Interpreter, number: Any) -> Any:
        if isinstance(number, Value):
            return own.trace.operation(operation, number, kind=kind)
        if holds_values([number]):
            raise Unsupported(f"{operation} of an array of numbers that are not known")
        return known(number)

    return apply


def _select(own: Interpreter, condition: Any, first: Scalar, second: Scalar) -> Any:
    if not isinstance(condition, Value):
        return first if condition else second
    kinds = {kind_of(first), kind_of(second)}
    kind = kinds.pop() if len(kinds) == 1 else Kind.REAL
    return own.trace.operation("select", condition, first, second, kind=kind)


def _smallest(own: Interpreter, first: Any, second: Any) -> Any:
    """Do as Python does: the second only where it is less."""
    return _select(own, second < first, second, first)


def _largest(own: Interpreter, first: Any, second: Any) -> Any:
    return _select(own, second > first, second, first)


def _whole(own: Interpreter, number: Any) -> Any:
    if not isinstance(number, Value) or number.kind is Kind.WHOLE:
        return number if isinstance(number, Value) else int(number)
    return own.trace.operation("whole", number, kind=Kind.WHOLE)


def _unchanged(known: Callable[[Any], Any]) -> Callable[..., Any]:
    def apply(own: Interpreter, number: Any) -> Any:
        return number if isinstance(number, Value) else known(number)

    return apply


def _has(own: Interpreter, thing: Any, name: str) -> bool:
    return not isinstance(thing, Value) and hasattr(thing, name)  # a value is a number, with no methods


def _clip(own: Interpreter, numbers: Any, low: Any, high: Any) -> Any:
    """Do as Python's min and max do, entry by entry; what is not a number stays so."""
    ends = (np.broadcast_to(end, np.shape(numbers)) for end in (low, high))
    made = own.array(np.asarray(numbers, dtype=object))
    for place, (least, most) in zip(np.ndindex(made.shape), zip(*map(np.ravel, ends), strict=True), strict=True):
        made[place] = _smallest(own, _largest(own, made[place], float(least)), float(most))
    return made


def _finite(own: Interpreter, number: Any) -> Any:
    if not isinstance(number, Value):
        return np.isfinite(number)
    nothing: Any = own.trace.arithmetic("-", number, number)
    return nothing == 0.0


def _sum(own: Interpreter, numbers: np.ndarray) -> Any:
    """Add up from the first to the last, as Numba does."""
    total: Any = 0.0
    for number in np.ravel(numbers):
        total = total + number
    return total


def _in_lanes(own: Interpreter, flags: Any, wanted: float, act: Any, seen: Any, *changed: Any) -> None:
    """Do in the one lane of a program what `in_lanes` does in those that it concerns."""
    condition = flags[0] == wanted
    if isinstance(condition, Value):
        own.either(condition, {}, lambda: own.call(act, [seen, *changed]), lambda: None)
    elif condition:
        own.call(act, [seen, *changed])


def _rolled(function: Any) -> Callable[..., None]:
    """Return what is done for a function of arrays that keeps its loops in the program."""

    def apply(own: Interpreter, *arrays: np.ndarray) -> None:
        own.trace.rolled(function, arrays, written(function))

    return apply


INTRINSICS: dict[Any, Callable[..., Any]] = {
    np.empty: _filled(UNKNOWN),
    np.zeros: _filled(0.0),
    np.ones: _filled(1.0),
    np.empty_like: _filled_like(UNKNOWN),
    np.zeros_like: _filled_like(0.0),
    np.sign: _scalar("sign", Kind.REAL, np.sign),
    np.floor: _scalar("floor", Kind.REAL, np.floor),
    np.rint: _scalar("rint", Kind.REAL, np.rint),
    np.sqrt: _scalar("sqrt", Kind.REAL, np.sqrt),
    np.abs: _scalar("abs", Kind.REAL, np.abs),
    np.isfinite: _finite,
    np.sum: _sum,
    np.clip: _clip,
    np.isnan: _scalar("isnan", Kind.TRUTH, np.isnan),
    np.where: _select,
    elementwise.select: _select,
    in_lanes: _in_lanes,
    **{function: _rolled(function) for function in ROLLED},
    builtins.min: _smallest,
    builtins.max: _largest,
    builtins.int: _whole,
    builtins.float: _unchanged(float),
    builtins.bool: _unchanged(bool),
    builtins.hasattr: _has,
}
"""By function: what is done instead of it, with the interpreter before the arguments."""
