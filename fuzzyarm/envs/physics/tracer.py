"""Symbols that record what is computed with them, and the flat source of what they have recorded.

An `Expression` is a number that arithmetic does not evaluate but writes down. Equal expressions are the same object
(hash-consing), and arithmetic with constants is done at once (0 x = 0, 1 x = x, x - x = 0, ...), so what a general
algorithm computes in vain for a particular robot, a product with the zero of a planar arm, leaves no trace.

    tracer = Tracer()
    x, y = tracer.input("x"), tracer.input("y")
    assignments([x * y + 0.0 * x], {})     # (["v0 = x * y"], ["v0"])

Names in the source are those given to `input` and `call`, which are the generator's own, and v0, v1, ...; numbers are
the `repr` of floats.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

__all__ = ["Expression", "Number", "Tracer", "assignments", "fixed_part"]

INPUT, CONSTANT, CALL, PART = "input", "constant", "call", "part"
ARITHMETIC = {"+": "{} + {}", "-": "{} - {}", "*": "{} * {}", "/": "{} / {}", "neg": "-{}"}


class Node(NamedTuple):
    """What an expression is: an operation, a name or a number, and the places of its operands."""

    operation: str
    value: str | float
    operands: tuple[int, ...]


class Tracer:
    """The expressions made so far, each of them once.

    Attributes:
        nodes: what each expression is; operands come before what is made of them.
        fixed: for each of them, whether it depends on fixed inputs only.
    """

    def __init__(self) -> None:
        """Begin without expressions."""
        self.nodes: list[Node] = []
        self.fixed: list[bool] = []
        self._places: dict[Node, int] = {}

    def input(self, name: str, *, fixed: bool = False) -> Expression:
        """Return the symbol for an argument of the generated function; fixed: one that does not change over a step."""
        return self._expression(Node(INPUT, name, ()), fixed)

    def call(self, name: str, arguments: Sequence[Number], results: int) -> tuple[Expression, ...]:
        """Return the symbols for the results of a function that the generated source calls."""
        operands = tuple(self.expression(argument).place for argument in arguments)
        called = self._expression(Node(CALL, name, operands), all(self.fixed[k] for k in operands))
        if results == 1:
            return (called,)
        return tuple(self._expression(Node(PART, float(k), (called.place,)), called.fixed) for k in range(results))

    def expression(self, number: Number) -> Expression:
        """Return a number as an expression."""
        if isinstance(number, Expression):
            return number
        return self._expression(Node(CONSTANT, float(number) + 0.0, ()), True)  # + 0.0: there is one zero only

    def operation(self, name: str, *operands: Expression) -> Expression:
        """Return the expression for an operation on others."""
        places = tuple(operand.place for operand in operands)
        if name in "+*":
            places = tuple(sorted(places))
        return self._expression(Node(name, "", places), all(self.fixed[k] for k in places))

    def _expression(self, node: Node, fixed: bool) -> Expression:
        place = self._places.get(node)
        if place is None:
            place = self._places[node] = len(self.nodes)
            self.nodes.append(node)
            self.fixed.append(fixed)
        return Expression(self, place)


class Expression:
    """A number that records the arithmetic done with it; see the module."""

    __slots__ = ("place", "tracer")

    def __init__(self, tracer: Tracer, place: int) -> None:
        """Refer to a node of a tracer."""
        self.tracer, self.place = tracer, place

    @property
    def fixed(self) -> bool:
        """Whether it depends on fixed inputs only."""
        return self.tracer.fixed[self.place]

    @property
    def constant(self) -> float | None:
        """Its value if it is a constant."""
        node = self.tracer.nodes[self.place]
        return float(node.value) if node.operation == CONSTANT else None

    @property
    def negated(self) -> Expression | None:
        """The expression that it is the negative of, if it was made so."""
        node = self.tracer.nodes[self.place]
        return Expression(self.tracer, node.operands[0]) if node.operation == "neg" else None

    def __neg__(self) -> Expression:
        """Return -x; -(-x) is x, and -(x - y) is y - x."""
        if self.constant is not None:
            return self.tracer.expression(-self.constant)
        if self.negated is not None:
            return self.negated
        node = self.tracer.nodes[self.place]
        if node.operation == "-":
            first, second = (Expression(self.tracer, place) for place in node.operands)
            return second - first
        return self.tracer.operation("neg", self)

    def __add__(self, other: Number) -> Expression:
        """Return x + y; x + 0 is x, and x + (-y) is x - y."""
        y = self.tracer.expression(other)
        if self.constant is not None and y.constant is not None:
            return self.tracer.expression(self.constant + y.constant)
        if y.constant == 0.0:
            return self
        if self.constant == 0.0:
            return y
        if y.negated is not None:
            return self - y.negated
        if self.negated is not None:
            return y - self.negated
        return self.tracer.operation("+", self, y)

    def __sub__(self, other: Number) -> Expression:
        """Return x - y; x - 0 is x, 0 - y is -y, x - x is 0, and x - (-y) is x + y."""
        y = self.tracer.expression(other)
        if self.constant is not None and y.constant is not None:
            return self.tracer.expression(self.constant - y.constant)
        if self.place == y.place:
            return self.tracer.expression(0.0)
        if y.constant == 0.0:
            return self
        if self.constant == 0.0:
            return -y
        if y.negated is not None:
            return self + y.negated
        if self.negated is not None:
            return -(self.negated + y)
        return self.tracer.operation("-", self, y)

    def __mul__(self, other: Number) -> Expression:
        """Return x y; 0 x is 0, 1 x is x, (-1) x is -x, and (-x) y is -(x y)."""
        y = self.tracer.expression(other)
        if self.constant is not None and y.constant is not None:
            return self.tracer.expression(self.constant * y.constant)
        if self.constant is not None:
            return y * self
        if y.constant is not None and abs(y.constant) in (0.0, 1.0):
            return self.tracer.expression(0.0) if y.constant == 0.0 else self if y.constant == 1.0 else -self
        if self.negated is not None:
            return -(self.negated * y)
        if y.negated is not None:
            return -(self * y.negated)
        return self.tracer.operation("*", self, y)

    def __truediv__(self, other: Number) -> Expression:
        """Return x / y."""
        y = self.tracer.expression(other)
        if self.constant is not None and y.constant is not None:
            return self.tracer.expression(self.constant / y.constant)
        return self if y.constant == 1.0 else self.tracer.operation("/", self, y)

    def __radd__(self, other: float) -> Expression:
        """Return y + x."""
        return self + other

    def __rsub__(self, other: float) -> Expression:
        """Return y - x."""
        return self.tracer.expression(other) - self

    def __rmul__(self, other: float) -> Expression:
        """Return y x."""
        return self * other

    def __rtruediv__(self, other: float) -> Expression:
        """Return y / x."""
        return self.tracer.expression(other) / self


Number = Expression | float
"""What arithmetic with expressions takes."""


def used_by(results: Sequence[Expression], known: Collection[int] = ()) -> list[int]:
    """Return the places of all that the results are made of, in an order to compute them; nothing behind the known."""
    order: list[int] = []
    seen: set[int] = set()
    waiting = [(result.place, False) for result in reversed(results)]
    while waiting:
        place, ready = waiting.pop()
        if ready:
            order.append(place)
        elif place not in seen:
            seen.add(place)
            waiting.append((place, True))
            if place not in known:
                operands = results[0].tracer.nodes[place].operands
                waiting.extend((operand, False) for operand in reversed(operands))
    return order


def fixed_part(results: Sequence[Expression]) -> list[Expression]:
    """Return what has to be known of the fixed inputs to compute the results: the largest fixed expressions in them."""
    tracer = results[0].tracer
    edge = {place for place, fixed in enumerate(tracer.fixed) if fixed}
    found = (Expression(tracer, place) for place in used_by(results, edge) if place in edge)
    return [expression for expression in found if expression.constant is None]


def assignments(results: Sequence[Expression], known: Mapping[int, str]) -> tuple[list[str], list[str]]:
    """Return the lines of source that compute the results, one operation each, and the names of the results.

    Args:
        results: what is wanted.
        known: by place, the source of expressions that need not be computed.
    """
    tracer, lines = results[0].tracer, list[str]()
    names = dict(known)
    for place in used_by(results, known):
        node = tracer.nodes[place]
        if place in names:
            continue
        operands = [names[operand] for operand in node.operands]
        if node.operation == CONSTANT:
            names[place] = f"({node.value!r})"
        elif node.operation == INPUT:
            names[place] = str(node.value)
        else:
            if node.operation == CALL:
                value = f"{node.value}({', '.join(operands)})"
            elif node.operation == PART:
                value = f"{operands[0]}[{int(node.value)}]"
            else:
                value = ARITHMETIC[node.operation].format(*operands)
            names[place] = f"v{len(lines)}"
            lines.append(f"{names[place]} = {value}")
    return lines, [names[result.place] for result in results]
