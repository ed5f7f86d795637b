"""Partial evaluation: the Python source of a law is executed, and what depends on values is recorded.

The interpreter walks the syntax tree of the very functions that the policy is made of, those that Numba compiles
included. What is known when the program is written, such as gains, loops over joints and rules, or indices, is done at
once by Python itself; arithmetic with a `Value` is recorded by it. A branch on a value becomes one of the program, with
the names and the entries of arrays that it changes merged behind it. Loops are unrolled, so the program has none.

A generated function, whose source is no file, is called as it is: it is straight, and the functions that it calls are
given to it interpreted.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.physics.records import flat
from fuzzyarm.export.frame import Frame, Return
from fuzzyarm.export.intrinsics import INTRINSICS, METHODS, holds_values
from fuzzyarm.export.refusals import Unsupported
from fuzzyarm.export.trace import UNKNOWN, Block, Branch, Function, Kind, Trace, Value

__all__ = ["Interpreter"]

_PACKAGE = __name__.partition(".")[0]
_LIBRARIES = sys.stdlib_module_names | {"numpy", "numba", "scipy"}


class Interpreter:
    """Executes functions of a law, see the module.

    Attributes:
        trace: the program that they have recorded.
        called: the names of the functions that were interpreted, each once, in order.
        depth: how many branches the next step is in.
    """

    def __init__(self, kept_apart: Sequence[Callable[..., Any]]) -> None:
        """Begin with an empty program.

        Args:
            kept_apart: functions of numbers and records that become functions of the program rather than part of it.
        """
        self.trace, self.called = Trace(), dict[str, None]()
        self.trace.kept_apart = self._call_apart
        self._apart = {function: function.__name__ for function in kept_apart}
        self._arrays: list[np.ndarray] = []  # that hold values, apart from views of them
        self._shapes: dict[str, Any] = {}  # what the functions of the program return, as the law's source has it
        self.depth = 0  # of branches

    def array(self, like: np.ndarray) -> np.ndarray:
        """Return an array of the program (any shape), with the entries of another one."""
        made = np.array(like, dtype=object)
        self._arrays.append(made)
        return made

    def call(self, function: Any, arguments: Sequence[Any], keywords: dict[str, Any] | None = None) -> Any:
        """Return what a function returns for these arguments."""
        keywords, function = keywords or {}, getattr(function, "py_func", function)
        if isinstance(function, types.MethodType):
            owner = function.__self__
            if not isinstance(owner, type) and not _is_law(type(owner)):
                return self._native(function, arguments, keywords)
            return self.call(function.__func__, [owner, *arguments], keywords)
        with contextlib.suppress(TypeError):  # what cannot be hashed is none of these
            if function in self._apart:
                return self._call_apart(function, arguments)
            if function in INTRINSICS:
                return INTRINSICS[function](self, *arguments, **keywords)
        if isinstance(function, types.FunctionType) and function.__code__.co_filename.startswith("<"):
            return self._generated(function)(*arguments, **keywords)
        if not isinstance(function, types.FunctionType) or not _is_law(function):
            return self._native(function, arguments, keywords)
        return self._interpret(function, arguments, keywords)

    def _native(self, function: Any, arguments: Sequence[Any], keywords: dict[str, Any]) -> Any:
        if getattr(function, "__name__", "") in METHODS and isinstance(getattr(function, "__self__", None), np.ndarray):
            return self.array(function(*arguments, **keywords))
        values = holds_values([*arguments, *keywords.values()])
        if values and not isinstance(function, type) and getattr(function, "__module__", "").startswith("numpy"):
            raise Unsupported(f"numpy's {function.__name__} of numbers that are not known")
        return function(*arguments, **keywords)

    def _generated(self, function: types.FunctionType) -> types.FunctionType:
        """Return a generated function whose calls are interpreted."""

        def interpreted(called: Any) -> Any:
            if isinstance(called, type) or not callable(called):
                return called
            return lambda *arguments: self.call(called, arguments)

        names = {name: interpreted(held) for name, held in function.__globals__.items() if name != "__builtins__"}
        return types.FunctionType(function.__code__, names, function.__name__, function.__defaults__)

    def _call_apart(self, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
        """Return what a function of the program gives; its arguments and results are numbers, or records of them."""
        name = self._apart[function]
        if name not in self.trace.functions:
            outside, self.trace.block = self.trace.block, []
            names = list(inspect.signature(function).parameters)
            given = [self._unknown(argument, own) for argument, own in zip(arguments, names, strict=True)]
            arrays, self._arrays = self._arrays, []
            result = self._interpret(getattr(function, "plain", function), given, {})
            self._arrays = arrays
            self._shapes[name] = result
            self.trace.functions[name] = Function(name, tuple(flat(given)), self.trace.block, tuple(flat([result])))
            self.trace.block = outside
        numbers = flat(arguments)
        if not any(isinstance(argument, Value) for argument in numbers):
            return function(*arguments)
        return _filled(self._shapes[name], iter(self.trace.call(self.trace.functions[name], numbers)))

    def _unknown(self, like: Any, name: str) -> Any:
        """Return values for a number, or for those of a record."""
        if isinstance(like, tuple):
            return type(like)(*(self._unknown(part, f"{name}_{own}") for own, part in like._asdict().items()))  # type: ignore[attr-defined]
        return Value(self.trace, Kind.REAL, name)

    def _interpret(self, function: Any, arguments: Sequence[Any], keywords: dict[str, Any]) -> Any:
        code = function.__code__
        self.called.setdefault(f"{function.__module__.removeprefix(_PACKAGE + '.')}.{code.co_qualname}")
        bound = inspect.signature(function).bind(*arguments, **keywords)
        bound.apply_defaults()
        names = dict(bound.arguments)
        for name, parameter in bound.signature.parameters.items():
            if parameter.kind is parameter.VAR_POSITIONAL:
                names[name] = tuple(names[name])
        closure = zip(code.co_freevars, function.__closure__ or (), strict=True)
        outer = {name: cell.cell_contents for name, cell in closure}
        frame = Frame(self, names, outer, function)
        try:
            frame.run()
        except Return as returned:
            return returned.value
        return None

    @contextlib.contextmanager
    def _into(self, block: Block) -> Iterator[None]:
        outside, self.trace.block = self.trace.block, block
        self.depth += 1
        try:
            yield
        finally:
            self.trace.block, self.depth = outside, self.depth - 1

    def either(
        self, condition: Value, names: dict[str, Any], then: Callable[[], Any], otherwise: Callable[[], Any]
    ) -> Any:
        """Execute two sides of a branch, merge `names` and all arrays behind it, and return what the sides return."""
        branch = Branch(condition, [], [])
        before, held = dict(names), [array.copy() for array in self._arrays]
        count, outcomes = len(self._arrays), []
        for block, side in ((branch.then, then), (branch.otherwise, otherwise)):
            names.clear()
            names.update(before)
            for array, entries in zip(self._arrays[:count], held, strict=True):
                array[...] = entries
            with self._into(block):
                result = side()
            outcomes.append((result, dict(names), [array.copy() for array in self._arrays[:count]]))
        (first, names1, arrays1), (second, names2, arrays2) = outcomes
        self.trace.block.append(branch)
        merged = functools.partial(self.trace.merged, branch)
        for name in {**names1, **names2}:
            names[name] = merged(names1.get(name, UNKNOWN), names2.get(name, UNKNOWN))
        for array, one, other in zip(self._arrays[:count], arrays1, arrays2, strict=True):
            for place in np.ndindex(array.shape):
                array[place] = merged(one[place], other[place])
        return merged(first, second)

    def check_owned(self, array: np.ndarray) -> None:
        """Refuse a write to an array (any shape) that the merging behind a branch would not see."""
        base = array
        while isinstance(base.base, np.ndarray):
            base = base.base
        if self.depth and not any(base is known for known in self._arrays):
            raise Unsupported("an entry of an array that is not the law's own changes within a branch")


def _is_law(thing: Any) -> bool:
    """Return whether a function or a class may be part of a law: whether it is none of Python's or of a library's."""
    return (getattr(thing, "__module__", None) or "").partition(".")[0] not in _LIBRARIES


def _filled(like: Any, numbers: Iterator[Any]) -> Any:
    """Return a number, or a tuple or record that has these numbers in the places of those that it has."""
    if not isinstance(like, tuple):
        return next(numbers)
    parts = [_filled(part, numbers) for part in like]
    return type(like)(*parts) if hasattr(like, "_fields") else tuple(parts)
