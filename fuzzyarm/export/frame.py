"""One call of a function of the law: its names, and what each kind of statement and expression does."""

from __future__ import annotations

import ast
import builtins
import functools
import inspect
import operator
import textwrap
import types
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzyarm.export.intrinsics import Row, entry_of
from fuzzyarm.export.refusals import TooLarge, Unsupported
from fuzzyarm.export.trace import UNKNOWN, Value

if TYPE_CHECKING:
    from fuzzyarm.export.partial import Interpreter

__all__ = ["Frame", "Return"]

_BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.MatMult: operator.matmul,
}
_IN_PLACE = {kind: getattr(operator, f"i{function.__name__.strip('_')}") for kind, function in _BINARY.items()}
_UNARY: dict[type, Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
    ast.Invert: operator.invert,
}
_COMPARISON: dict[type, Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
}


class Return(Exception):
    """A function of the law returns `value`."""

    def __init__(self, value: Any) -> None:
        self.value = value


class Frame:
    """One call of a function: its names, and what its statements and expressions do."""

    def __init__(
        self, interpreter: Interpreter, names: dict[str, Any], outer: dict[str, Any], function: types.FunctionType
    ) -> None:
        """Begin a call.

        Args:
            interpreter: of the law.
            names: the arguments by name.
            outer: what the function finds around itself, by name.
            function: what is called.
        """
        self._own, self._names, self._outer, self._function = interpreter, names, outer, function
        self._entered = interpreter.depth

    def run(self) -> None:
        """Execute the function; it raises `Return` where it returns."""
        self.execute(_definition(self._function).body)

    def execute(self, statements: Sequence[ast.stmt]) -> None:
        """Execute statements in order."""
        for statement in statements:
            visit = getattr(self, f"_do_{type(statement).__name__.lower()}", None)
            if visit is None:
                raise self._unsupported(statement, "a statement of this kind")
            try:
                visit(statement)
            except Unsupported as error:
                if isinstance(error, TooLarge) or " (in " in str(error):
                    raise
                raise self._unsupported(statement, str(error)) from None

    def _unsupported(self, node: ast.stmt, what: str) -> Unsupported:
        line = self._function.__code__.co_firstlineno + node.lineno - 1
        return Unsupported(f"{what} (in {self._function.__module__}, line {line})")

    def _do_pass(self, node: ast.Pass) -> None:
        pass

    def _do_assert(self, node: ast.Assert) -> None:
        pass

    def _do_expr(self, node: ast.Expr) -> None:
        self._value(node.value)

    def _do_return(self, node: ast.Return) -> None:
        if self._own.depth > self._entered:
            raise Unsupported("a return within a branch")
        raise Return(None if node.value is None else self._value(node.value))

    def _do_assign(self, node: ast.Assign) -> None:
        value = self._value(node.value)
        for target in node.targets:
            self._assign(target, value)

    def _do_annassign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self._assign(node.target, self._value(node.value))

    def _do_augassign(self, node: ast.AugAssign) -> None:
        before = self._value(node.target)
        if isinstance(before, np.ndarray):
            self._own.check_owned(before)
        self._assign(node.target, _IN_PLACE[type(node.op)](before, self._value(node.value)))

    def _do_for(self, node: ast.For) -> None:
        for item in self._value(node.iter):
            self._assign(node.target, item)
            self.execute(node.body)

    def _do_if(self, node: ast.If) -> None:
        condition = self._value(node.test)
        if isinstance(condition, Value):
            self._own.either(condition, self._names, lambda: self.execute(node.body), lambda: self.execute(node.orelse))
        else:
            self.execute(node.body if condition else node.orelse)

    def _assign(self, target: ast.expr, value: Any) -> None:
        match target:
            case ast.Name(id=name):
                _call_it(value, name)
                self._names[name] = value
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                entries = list(value)
                if len(entries) != len(parts):
                    raise Unsupported(f"{len(entries)} values for {len(parts)} names")
                for part, entry in zip(parts, entries, strict=True):
                    self._assign(part, entry)
            case ast.Subscript(value=holder, slice=index):
                array, place = self._value(holder), self._value(index)
                if isinstance(place, Value) or (isinstance(place, tuple) and any(isinstance(p, Value) for p in place)):
                    raise Unsupported("a write to a place that is not known")
                if isinstance(array, np.ndarray):
                    self._own.check_owned(array)
                _call_it(value, _name_of(holder, place))
                array[place] = value
            case _:
                raise Unsupported("an assignment to something else than names and entries")

    def _value(self, node: ast.expr) -> Any:
        visit = getattr(self, f"_of_{type(node).__name__.lower()}", None)
        if visit is None:
            raise Unsupported(f"an expression of the kind {type(node).__name__}")
        value = visit(node)
        if value is UNKNOWN:
            raise Unsupported("a name that only one side of a branch defines")
        return value

    def _of_constant(self, node: ast.Constant) -> Any:
        return node.value

    def _of_name(self, node: ast.Name) -> Any:
        for names in (self._names, self._outer, self._function.__globals__, vars(builtins)):
            if node.id in names:
                return names[node.id]
        raise Unsupported(f"the name {node.id} before it has a meaning")

    def _of_attribute(self, node: ast.Attribute) -> Any:
        return getattr(self._value(node.value), node.attr)

    def _of_tuple(self, node: ast.Tuple) -> Any:
        return tuple(self._all(node.elts))

    def _of_list(self, node: ast.List) -> Any:
        return self._all(node.elts)

    def _all(self, nodes: Sequence[ast.expr]) -> list[Any]:
        found: list[Any] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                found.extend(self._value(node.value))
            else:
                found.append(self._value(node))
        return found

    def _of_slice(self, node: ast.Slice) -> Any:
        return slice(*(None if part is None else self._value(part) for part in (node.lower, node.upper, node.step)))

    def _of_subscript(self, node: ast.Subscript) -> Any:
        holder, place = self._value(node.value), self._value(node.slice)
        if isinstance(place, Value):
            return Row(self._own.trace, holder, place, _name_of(node.value, ()))
        if isinstance(place, tuple) and any(isinstance(index, Value) for index in place):
            return entry_of(self._own.trace, holder, place, _name_of(node.value, ()))
        return holder[place]

    def _of_binop(self, node: ast.BinOp) -> Any:
        return _BINARY[type(node.op)](self._value(node.left), self._value(node.right))

    def _of_unaryop(self, node: ast.UnaryOp) -> Any:
        operand = self._value(node.operand)
        if isinstance(node.op, ast.Not) and isinstance(operand, Value):
            return ~operand
        return _UNARY[type(node.op)](operand)

    def _of_boolop(self, node: ast.BoolOp) -> Any:
        decisive = isinstance(node.op, ast.Or)
        result: Any = not decisive
        for part in node.values:
            value = self._value(part)
            if isinstance(value, Value):
                combined = operator.or_ if decisive else operator.and_
                result = combined(result, value) if isinstance(result, Value) else value
            elif bool(value) is decisive:
                return value
        return result

    def _of_compare(self, node: ast.Compare) -> Any:
        left, result = self._value(node.left), True
        for kind, right_node in zip(node.ops, node.comparators, strict=True):
            right = self._value(right_node)
            found = _COMPARISON[type(kind)](left, right)
            result = found if result is True else result & found
            left = right
        return result

    def _of_ifexp(self, node: ast.IfExp) -> Any:
        condition = self._value(node.test)
        if isinstance(condition, Value):
            return self._own.either(
                condition, self._names, lambda: self._value(node.body), lambda: self._value(node.orelse)
            )
        return self._value(node.body if condition else node.orelse)

    def _of_call(self, node: ast.Call) -> Any:
        keywords = {keyword.arg: self._value(keyword.value) for keyword in node.keywords if keyword.arg is not None}
        return self._own.call(self._value(node.func), self._all(node.args), keywords)


@functools.cache
def _definition(function: types.FunctionType) -> ast.FunctionDef:
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    if not isinstance(definition, ast.FunctionDef):
        raise Unsupported(f"{function.__name__}, which is no function with a name")
    return definition


def _call_it(value: Any, name: str) -> None:
    """Give a value the first name that the law's source gives it."""
    if isinstance(value, Value) and not value.name:
        value.name = name.strip("_")


def _name_of(holder: ast.expr, place: Any) -> str:
    """Return a name for an entry of something: that of the thing, and its last index."""
    name = holder.id if isinstance(holder, ast.Name) else holder.attr if isinstance(holder, ast.Attribute) else "value"
    last = place[-1] if isinstance(place, tuple) and place else place
    return f"{name}{last}" if isinstance(last, int | np.integer) else name
