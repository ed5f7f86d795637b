"""The C text of a recorded program: one statement an operation, in the order of the law's source.

What nothing needs is left out; an operation that is used once and has no name of its own stands where it is used, in
brackets, which changes neither its operands nor its rounding.

C functions of the exported programs that do what Python does by itself or by its library, to the bit.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from fuzzyarm.export.trace import Block, Branch, Function, Kind, Loops, Matrix, Scalar, Step, Value, kind_of

__all__ = ["HELPERS", "ROLLED", "Writer", "helper_text", "pruned", "wrapped"]


ROLLED = {
    "add_product": """/* Adds G x to y; G is given by columns, so that no sum runs over the rows. */
static void add_product(const {real} *x, int x_size, const {real} *transposed, int columns, {real} *y, int y_size)
{{
    int k;
    int j;
    for (k = 0; k < x_size; k++) {{
        for (j = 0; j < y_size; j++) {{
            y[j] = y[j] + (transposed[(k * columns) + j] * x[k]);
        }}
    }}
}}
""",
}
"""By name, the functions of arrays that keep their loops; see `learned_policy.functions`."""

HELPERS = {
    "rint": """/* The nearest whole number, the even one of two; exact. */
static {real} rint_({real} x)
{{
    const {real} large = {large};
    {real} result = x;
    if ((x > -large) && (x < large)) {{
        result = (x > {zero}) ? ((x + large) - large) : ((x - large) + large);
        if (result == {zero}) {{
            result = x * {zero};
        }}
    }}
    return result;
}}
""",
    "floor": """/* The largest whole number that is not above x; exact. */
static {real} floor_({real} x)
{{
    const {real} nearest = rint_(x);
    return (nearest > x) ? (nearest - {one}) : nearest;
}}
""",
    "abs": """static {real} abs_({real} x)
{{
    return (x <= {zero}) ? ({zero} - x) : x;
}}
""",
    "sign": """static {real} sign_({real} x)
{{
    return (x > {zero}) ? {one} : ((x < {zero}) ? -{one} : ((x == {zero}) ? {zero} : x));
}}
""",
    "sqrt": """/* The square root, rounded correctly: y = x/scale^2 in [1, 4), Newton, exact residual y - r^2. */
static {real} sqrt_({real} x)
{{
    static const {real} power[{steps}] = {{
{powers}
    }};
    static const {real} root[{steps}] = {{
{roots}
    }};
    const {real} unit = {epsilon}_EPSILON;
    {real} result = x;
    if ((x > {zero}) && (x <= {epsilon}_MAX)) {{
        const _Bool tiny = x < {epsilon}_MIN;
        {real} scale = tiny ? {drop} : {one};
        {real} y = tiny ? (x * {lift}) : x;
        {real} r;
        {real} high;
        {real} low;
        {real} residual;
        int k;
        for (k = 0; k < {steps}; k++) {{
            if (y >= power[k]) {{
                y = y * ({one} / power[k]);
                scale = scale * root[k];
            }}
            if ((y * power[k]) < {four}) {{
                y = y * power[k];
                scale = scale * ({one} / root[k]);
            }}
        }}
        r = {half} + ({half} * y);
        for (k = 0; k < 5; k++) {{
            r = {half} * (r + (y / r));
        }}
        high = {split} * r;
        high = high - (high - r);
        low = r - high;
        residual = ((y - (high * high)) - ({two} * (high * low))) - (low * low);
        if (residual > (r * unit)) {{
            r = r + unit;
        }} else if (residual <= -(r * unit)) {{
            r = r - unit;
        }} else {{
            /* r is the nearest number. */
        }}
        result = r * scale;
    }} else if (x < {zero}) {{
        result = (x - x) / (x - x);
    }} else {{
        /* 0, infinity and what is no number stay so. */
    }}
    return result;
}}
""",
    "whole": """/* x without its fraction; what is no small number becomes -32767. */
static int whole_({real} x)
{{
    return ((x > {low}) && (x < {high})) ? (int)x : -32767;
}}
""",
}
"""By operation, the C function that does it without a library; `floor` needs `rint`."""


def helper_text(operation: str, real: str, literal: Callable[[float], str]) -> str:
    """Return the C function of an operation.

    Args:
        operation: a key of `HELPERS`.
        real: "double" or "float".
        literal: writes a number of this type.
    """
    digits, steps = {"double": (53, 9), "float": (24, 6)}[real]
    exponents = [2**step for step in range(steps, 0, -1)]
    lift = 2 * (digits // 2 + 1)
    numbers = {
        **{"zero": 0.0, "half": 0.5, "one": 1.0, "two": 2.0, "four": 4.0, "low": -32768.0, "high": 32768.0},
        **{"large": 2.0 ** (digits - 1), "split": 2.0 ** (digits - digits // 2) + 1.0},
        **{"lift": 2.0**lift, "drop": 2.0 ** (-lift // 2)},
    }
    lists = {
        "powers": _lines(literal(2.0**exponent) for exponent in exponents),
        "roots": _lines(literal(2.0 ** (exponent // 2)) for exponent in exponents),
    }
    words = {"real": real, "steps": str(steps), "epsilon": {"double": "DBL", "float": "FLT"}[real]}
    return HELPERS[operation].format(**words, **lists, **{name: literal(number) for name, number in numbers.items()})


def _lines(texts: Iterable[str]) -> str:
    indent = " " * 8
    return textwrap.fill(", ".join(texts), 100, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


LONGEST = 70  # characters of an operation that stands where it is used
_INDENT, _WIDTH = "    ", 110
_INFIX = ("+", "-", "*", "/", "<", "<=", ">", ">=", "==", "!=", "&&", "||")
_WORDS = frozenset(
    (
        *("auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern"),
        *("float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed"),
        *("sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while"),
        *("state", "observation", "torque", "memory"),
    )
)


def pruned(block: Block, needed: set[Value]) -> Block:
    """Return a block without what nothing needs, and add what it needs to `needed`."""
    kept: Block = []
    for step in reversed(block):
        if isinstance(step, Step):
            if any(result in needed for result in step.results):
                needed.update(operand for operand in step.operands if isinstance(operand, Value))
                kept.append(step)
            continue
        merged = [entry for entry in step.merged if entry[0] in needed]
        if not merged:
            continue
        needed.add(step.condition)
        needed.update(value for _, *sides in merged for value in sides if isinstance(value, Value))
        otherwise, then = pruned(step.otherwise, needed), pruned(step.then, needed)
        kept.append(Branch(step.condition, then, otherwise, merged))
    return kept[::-1]


class Writer:
    """Writes blocks of one function of a program.

    Attributes:
        used: the operations of `HELPERS` that were needed, and the names of functions that were called.
    """

    def __init__(self, real: str, taken: Iterable[str]) -> None:
        """Begin a function.

        Args:
            real: "double" or "float".
            taken: names that mean something else in the program.
        """
        self.used: set[str] = set()
        self._real, self._taken = real, {*_WORDS, *taken}
        self._numbers: dict[str, int] = {}  # of the last name made of a word
        self._texts: dict[Value, str] = {}
        self._uses: Counter[Value] = Counter()

    def function(self, function: Function) -> str:
        """Return the definition of a function of the program."""
        several = len(function.results) > 1
        names = [f"{self._real} {self._named(value)}" for value in function.parameters]
        names += [f"{self._real} *result{k + 1}" for k in range(len(function.results))] if several else []
        kind = "void" if several else self._type(kind_of(function.results[0]))
        outputs = [f"*result{k + 1} = {{}};" for k in range(len(function.results))] if several else ["return {};"]
        lines = self.body(function.body, list(zip(outputs, function.results, strict=True)))
        head = wrapped([f"static {kind} {function.name}({names[0]}", *names[1:]], "", _INDENT)
        return "\n".join([*head[:-1], f"{head[-1]})", "{", *lines, "}", ""])

    def body(self, block: Block, outputs: Sequence[tuple[str, Scalar]]) -> list[str]:
        """Return the lines of a block, and then those of its outputs: a text with {} for the value, and the value."""
        needed = {value for _, value in outputs if isinstance(value, Value)}
        self._uses.update(value for _, value in outputs if isinstance(value, Value))
        kept = pruned(block, needed)
        self._count(kept)
        lines = self._block(kept, _INDENT)
        return lines + [_INDENT + text.format(self._text(value, Kind.REAL)) for text, value in outputs]

    def literal(self, number: float, kind: Kind = Kind.REAL) -> str:
        """Return a known number; one too small for float is the smallest normal one, as it guards a division."""
        if kind is not Kind.REAL:
            return str(int(number))
        if number != number:  # what is no number; C99 has no literal for it
            return f"({self.literal(0.0)} / {self.literal(0.0)})"
        smallest = float(np.finfo(np.float32).tiny) if self._real == "float" else 0.0
        if 0.0 < abs(number) < smallest:
            number = math.copysign(smallest, number)
        text = repr(float(number)) + ("f" if self._real == "float" else "")
        return f"({text})" if text.startswith("-") else text

    def _count(self, block: Block) -> None:
        for step in block:
            if isinstance(step, Step):
                self._uses.update(operand for operand in step.operands if isinstance(operand, Value))
            else:
                self._uses[step.condition] += 1
                self._uses.update(side for _, *sides in step.merged for side in sides if isinstance(side, Value))
                self._count(step.then)
                self._count(step.otherwise)

    def _type(self, kind: Kind) -> str:
        return {Kind.REAL: self._real, Kind.WHOLE: "int", Kind.TRUTH: "_Bool"}[kind]

    def _named(self, value: Value) -> str:
        """Return a new name for a value, and let it mean the value from now on."""
        base = re.sub(r"\W", "", value.name, flags=re.ASCII) or "v"
        self._texts[value] = name = self._free(f"v{base}" if base[0].isdigit() else base)
        return name

    def _free(self, base: str) -> str:
        """Return a name that means nothing yet, `base` or one made of it."""
        number = self._numbers.get(base, 1)
        name = base
        while name in self._taken or name == "v":
            number += 1
            name = f"{base}_{number}" if base != "v" else f"v{number - 1}"
        self._numbers[base] = number
        self._taken.add(name)
        return name

    def _block(self, block: Block, indent: str) -> list[str]:
        lines: list[str] = []
        for step in block:
            if isinstance(step, Loops):
                lines += self._loops(step, indent)
                continue
            lines += self._step(step, indent) if isinstance(step, Step) else self._branch(step, indent)
        return lines

    def _step(self, step: Step, indent: str) -> list[str]:
        if step.operation == "call":
            self.used.add(step.detail)
        arguments = [self._text(operand, Kind.REAL) for operand in step.operands] if step.operation == "call" else []
        if len(step.results) > 1:
            names = [self._named(result) for result in step.results]
            lines = [f"{indent}{self._real} {name};" for name in names]
            return [*lines, f"{indent}{step.detail}({', '.join([*arguments, *(f'&{name}' for name in names)])});"]
        (result,) = step.results
        text = f"{step.detail}({', '.join(arguments)})" if step.operation == "call" else self._expression(step)
        if self._uses[result] == 1 and not result.name and len(text) <= LONGEST and step.operation != "input":
            self._texts[result] = f"({text})" if " " in text and step.operation != "call" else text
            return []
        return [f"{indent}const {self._type(result.kind)} {self._named(result)} = {text};"]

    def _loops(self, step: Loops, indent: str) -> list[str]:
        """Return the call of a function of arrays: entries go into arrays of the program and are read from there."""
        self.used.add(step.detail)
        lines, arguments, results = list[str](), list[str](), iter(step.results)
        for entries, changes in zip(step.arrays, step.changed, strict=True):
            if isinstance(entries, Matrix):
                arguments += [f"&{entries.name}[0][0]", str(entries.columns)]
                continue
            name, texts = self._free("sums" if changes else "given"), [self._text(e, Kind.REAL) for e in entries]
            constant = "" if changes else "const "
            lines += [f"{indent}{constant}{self._real} {name}[{len(entries)}] = {{", *wrapped(texts, indent + _INDENT)]
            lines.append(f"{indent}}};")
            arguments += [name, str(len(entries))]
            if changes:
                for place in range(len(entries)):
                    self._texts[next(results)] = f"{name}[{place}]"
        return [*lines, f"{indent}{step.detail}({', '.join(arguments)});"]

    def _branch(self, branch: Branch, indent: str) -> list[str]:
        condition = self._text(branch.condition, Kind.TRUTH)
        if not branch.then and not branch.otherwise:
            chosen = []
            for value, first, second in branch.merged:
                ways = f"{self._text(first, value.kind)} : {self._text(second, value.kind)}"
                chosen.append(f"{indent}const {self._type(value.kind)} {self._named(value)} = {condition} ? {ways};")
            return chosen
        sides = []
        for number, block in enumerate((branch.then, branch.otherwise), start=1):
            inner = self._block(block, indent + _INDENT)
            sides.append((inner, [self._text(entry[number], entry[0].kind) for entry in branch.merged]))
        names = [self._named(value) for value, *_ in branch.merged]
        lines = [
            f"{indent}{self._type(value.kind)} {name};" for name, (value, *_) in zip(names, branch.merged, strict=True)
        ]
        for word, (inner, texts) in zip((f"if ({_bare(condition)}) {{", "} else {"), sides, strict=True):
            assigned = [f"{indent}{_INDENT}{name} = {text};" for name, text in zip(names, texts, strict=True)]
            lines += [indent + word, *inner, *assigned]
        return [*lines, f"{indent}}}"]

    def _expression(self, step: Step) -> str:
        operation, operands = step.operation, step.operands
        if operation == "input":
            return step.detail
        if operation == "lookup":
            return f"{step.detail}[{self._text(operands[0], Kind.WHOLE)}][{int(operands[1])}]"  # type: ignore[arg-type]
        if operation in _INFIX:
            kinds = {kind_of(operand) for operand in operands}
            kind = Kind.TRUTH if operation in ("&&", "||") else Kind.WHOLE if kinds == {Kind.WHOLE} else Kind.REAL
            if operation == "/":
                kind = Kind.REAL
            first, second = (self._text(operand, kind) for operand in operands)
            return f"{first} {operation} {second}"
        if operation == "%":  # Python's, whose sign is that of the divisor
            first, second = (self._text(operand, Kind.WHOLE) for operand in operands)
            return f"(({first} % {second}) + {second}) % {second}"
        if operation == "select":
            kind = step.results[0].kind
            ways = " : ".join(self._text(operand, kind) for operand in operands[1:])
            return f"{self._text(operands[0], Kind.TRUTH)} ? {ways}"
        (operand,) = operands
        if operation == "not":
            return f"!{self._text(operand, Kind.TRUTH)}"
        text = self._text(operand, Kind.REAL if operation in HELPERS else kind_of(operand))
        if operation == "neg":
            return f"-{text}"
        if operation == "isnan":
            return f"{text} != {text}"
        self.used |= {operation, "rint"} if operation == "floor" else {operation}
        return f"{operation}_({text})"

    def _text(self, scalar: Scalar, kind: Kind) -> str:
        """Return a value or a number as text of a kind."""
        if not isinstance(scalar, Value):
            return self.literal(float(scalar), kind)
        text = self._texts[scalar]
        if scalar.kind is kind or kind is Kind.TRUTH:
            return text
        if scalar.kind is Kind.TRUTH:
            return f"({text} ? {self.literal(1, kind)} : {self.literal(0, kind)})"
        return f"({self._type(kind)}){text}"


def wrapped(texts: Iterable[str], indent: str, further: str | None = None) -> list[str]:
    """Return lines with these texts and commas between them; the second and later ones may have another indent."""
    then = indent if further is None else further
    form = textwrap.TextWrapper(
        _WIDTH, initial_indent=indent, subsequent_indent=then, break_long_words=False, break_on_hyphens=False
    )
    return form.wrap(", ".join(texts))


def _bare(text: str) -> str:
    """Return a condition without the brackets around all of it."""
    inner = text[1:-1]
    balanced, depth = text.startswith("(") and text.endswith(")"), 0
    for mark in inner:
        depth += {"(": 1, ")": -1}.get(mark, 0)
        balanced = balanced and depth >= 0
    return inner if balanced else text
