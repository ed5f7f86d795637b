"""Functions of arrays whose loops stay loops in C: their Python source, translated statement by statement.

Such a function has loops over ``range(len(array))``, assignments to entries of its arguments, +, -, * and numbers. A
vector comes with its length, a matrix with the length of its rows; neither depends on data.
"""

from __future__ import annotations

import ast
import functools
import inspect
import textwrap
from collections.abc import Callable
from typing import Any

from fuzzyarm.learned_policy.functions import add_product

__all__ = ["ROLLED", "loops_text", "written"]

ROLLED = (add_product,)
"""The functions that keep their loops."""

_SIGNS: dict[type, str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*"}
_INDENT = "    "


@functools.cache
def written(function: Callable[..., None]) -> tuple[bool, ...]:
    """Return of each argument whether the function assigns to its entries."""
    definition = _definition(function)
    targets = {
        node.value.id
        for node in ast.walk(definition)
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store) and isinstance(node.value, ast.Name)
    }
    return tuple(argument.arg in targets for argument in definition.args.args)


def loops_text(function: Callable[..., None], real: str) -> str:
    """Return the C definition of a function; `real` is "double" or "float"."""
    definition, arguments = _definition(function), list[str]()
    matrices = {
        node.value.id
        for node in ast.walk(definition)
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Tuple) and isinstance(node.value, ast.Name)
    }
    for argument, changes in zip(definition.args.args, written(function), strict=True):
        count = f"{argument.arg}_{'columns' if argument.arg in matrices else 'size'}"
        arguments += [f"{'' if changes else 'const '}{real} *{argument.arg}", f"int {count}"]
    counters = sorted({node.target.id for node in ast.walk(definition) if isinstance(node, ast.For)})  # type: ignore[attr-defined]
    lines = [f"static void {definition.name}({', '.join(arguments)})", "{"]
    lines += [f"{_INDENT}int {counter};" for counter in counters]
    for statement in definition.body[1:]:  # the first is the docstring
        lines += _statement(statement, _INDENT)
    return "\n".join([*lines, "}", ""])


def _definition(function: Callable[..., None]) -> ast.FunctionDef:
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(definition, ast.FunctionDef)
    return definition


def _statement(node: ast.stmt, indent: str) -> list[str]:
    match node:
        case ast.For(target=ast.Name(id=k), iter=ast.Call(args=[ast.Call(args=[ast.Name(id=array)])]), body=body):
            inner = [line for statement in body for line in _statement(statement, indent + _INDENT)]
            return [f"{indent}for ({k} = 0; {k} < {array}_size; {k}++) {{", *inner, f"{indent}}}"]
        case ast.AugAssign(target=target, op=sign, value=value):
            place = _expression(target)
            return [f"{indent}{place} = {place} {_SIGNS[type(sign)]} {_expression(value)};"]
    raise NotImplementedError(f"a loop of {type(node).__name__}")


def _expression(node: Any) -> str:
    match node:
        case ast.Name(id=name):
            return str(name)
        case ast.Subscript(value=ast.Name(id=array), slice=ast.Tuple(elts=[row, column])):
            return f"{array}[({_expression(row)} * {array}_columns) + {_expression(column)}]"
        case ast.Subscript(value=ast.Name(id=array), slice=place):
            return f"{array}[{_expression(place)}]"
        case ast.BinOp(left=left, op=sign, right=right):
            return f"({_expression(left)} {_SIGNS[type(sign)]} {_expression(right)})"
    raise NotImplementedError(f"an expression of {type(node).__name__} in a loop")
