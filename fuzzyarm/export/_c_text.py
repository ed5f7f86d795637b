"""The C text of a recorded program: one statement per operation, in the order of the law's source; loops stay loops.

Unused operations are left out. An operation that is used once, in the region where it is computed, is written in
parentheses at its use. The source contains C functions that replace those of the math library and give the same bits.
"""

import functools
import inspect
import itertools
import math
import re
import textwrap
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.observation import Observation
from fuzzyarm.fuzzy_policy.law import law_of, seen_by, within_limits
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import flat, like
from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.symbols import Branch, For, Loop, Region, Store, Symbol

__all__ = ["LARGEST", "LAW", "MODEL", "Recorded", "Unsupported", "program_of"]


class Unsupported(ValueError):
    """Error for a part of a law that cannot be exported; the message names the part and its place."""


_LARGE = 16  # entries from which an array lies in the state; compilers keep smaller arrays in registers
_LARGEST = 2**18  # entries allowed in all tables of a program: 2 MiB in double precision

LAW, MODEL = ("observation", "torque"), ("input", "output")
"""Names in C of the input and output arrays of a step: those of a law, and those of a co-simulation model."""

LARGEST = 1e6
"""Largest magnitude in an observation for which a law acts; beyond it sine and cosine lose their digits."""


class _Function(NamedTuple):
    """A C function of the exported program, whose arguments and results are single numbers."""

    name: str  # in the program
    program: Program  # its ports are the arguments and the results
    parameters: tuple[tuple[int, str], ...]  # index and name of each argument that it needs
    result: Any  # a tree with as many numbers as it returns


class _Program(Program):
    """A program that keeps functions marked `apart` separate, in `functions`, in the order of their definition."""

    def __init__(self, functions: dict[Callable[..., Any], _Function], *given: Any) -> None:
        self.functions = functions
        super().__init__(*given)

    def apart(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Record the call of a function marked `apart` and return its results.

        If all arguments are constants, so are the results.
        """
        numbers = [self._real(one) for one in flat(arguments)]
        if not any(isinstance(one, Symbol) for one in numbers):
            return function(*arguments)
        own = self.functions.get(function) or self._function(function, arguments)
        operands = [numbers[place] for place, _ in own.parameters]
        results = (self.operation("call", *operands, detail=(own, k)) for k in range(own.program.ports[1]))
        return like(own.result, results)

    def _function(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> _Function:
        """Record a function and return the record; a call with nan for each number shows the shape of the result."""
        result = function(*like(arguments, itertools.repeat(math.nan)))

        def whole(given: Any, *_: Any) -> tuple[Any, Any]:
            return given, tuple(flat((function(*given),)))

        program = _Program(self.functions, whole, (arguments, (0.0,) * len(flat((result,)))))
        needed = _Uses(program, program.outputs[program.ports[0] :]).regions
        pairs = zip(inspect.signature(function).parameters, arguments, strict=True)
        named = enumerate(name for pair in pairs for name in _named(*pair))
        texts = ((k, name if name.isascii() else f"given{k}_") for k, name in named)
        parameters = tuple((k, name) for k, name in texts if program.inputs[k] in needed)
        own = re.sub(r"\W", "", function.__name__, flags=re.ASCII).strip("_")
        made = _Function(f"{own}{len(self.functions) + 1}", program, parameters, result)
        self.functions[function] = made
        return made


def _named(name: str, tree: Any) -> list[str]:
    if not isinstance(tree, tuple):
        return [f"{name}_"]  # no keyword of C
    parts = getattr(tree, "_fields", range(len(tree)))
    return [one for part, inner in zip(parts, tree, strict=True) for one in _named(f"{name}_{part}", inner)]


class Recorded(_Program):
    """The program of a control step of a policy or a plant: ``step(given, memory, *tables)`` returns memory and result.

    The ports are the memory, the inputs `given` and the result. The input of a policy is the observation, its result
    the torques of all motors [N m].
    """

    def __init__(
        self,
        step: Callable[..., tuple[Any, Any]],
        given: tuple[Sequence[str], Any],
        memory: Any,
        results: int,
        words: tuple[str, str],
        source: str,
        contents: Sequence[np.ndarray] = (),
    ) -> None:
        """Record a function of numbers; `Unsupported` if it does something that cannot be written in C.

        `given` contains the names of the inputs and a tree of as many zeros; `memory` is a tree of zeros and `Cells`;
        `results` is the number of results. `words`, `LAW` or `MODEL`, names the arrays; `source` names the recorded
        function of the package; `contents` has the content of the tables.
        """
        (self.names, zeros), self.words, self.source, self.contents = given, words, source, contents

        def whole(memory: Any, given: Any, _: Any, __: Any, *tables: Any) -> tuple[Any, Any, Any]:
            after, result = step(given, memory, *tables)
            return after, given, tuple(result)

        try:
            super().__init__({}, whole, (memory, zeros, (0.0,) * results), (), [table.shape for table in contents])
        except TypeError as error:
            raise Unsupported(
                f"while the code is generated, {source} needs a value that is known only at run time: {error}"
            ) from error

    @functools.cached_property
    def large(self) -> dict[str, int]:
        """Names and sizes of the arrays that lie in the state, not on the stack."""
        read = _Uses(self, self.outputs).read
        sizes = {f"array{k}": size for k, size in enumerate(self.arrays)}
        return {array: size for array, size in sizes.items() if size >= _LARGE and array in read}

    def source_text(self, name: str, real: str) -> str:
        """Return the C source; names in it begin with `name`, numbers are of type `real`, "double" or "float".

        `Unsupported` if an operation cannot be written in C.
        """
        writer, zero = _CWriter(self, real), _literal_of(0.0, real)
        lines, functions = writer.step(), list[str]()
        for function in reversed(self.functions.values()):  # a function calls only those before it
            if function.name in writer.used:
                functions.insert(0, writer.function(function))
        helpers = [_helper_text(operation, real) for operation in _HELPERS if operation in writer.used]
        tables = [_table(number, self.contents[number], real) for number in sorted(writer.tables)]
        words = [word for word in ("state", self.words[0]) if not re.search(rf"\b{word}(\[|->)", "\n".join(lines))]
        unused = [f"{_INDENT}(void){word};" for word in words]
        law, sizes = self.words is LAW, map(str, (max(self.ports[0], 1), *self.ports[1:]))
        marks = dict(zip(("memory", "inputs", "results"), sizes, strict=True)) | {"zero": zero}
        marks |= {"result": self.words[1], "most": _literal_of(LARGEST, real)}
        parts = ("guard", "hold", "check", "end")
        guard, hold, check, end = (_marked(_HELPERS[part], marks).rstrip() for part in parts)
        body = [guard, *tables, *lines, hold, end] if law else [*tables, *unused, *lines, check, end]
        start = "\n".join(
            [
                f"void {name}_init({name}_state *state)\n{{",
                *(_zeroed(part, self.ports[port], zero) for part, port in (("memory", 0), ("torque", 2))[: 1 + law]),
                "}\n",
            ]
        )
        step = "\n".join([self._head(name, real), "{", *body, "}", ""])
        text = "\n".join([f'#include "{name}.h"', "", start, *helpers, *functions, step])
        own = "|".join(re.findall(r"^static \w+ (\w+)\(", text, re.MULTILINE))
        return re.sub(rf"\b({own})\(", rf"{name}_part_\1(", text) if own else text  # a file may have several programs

    def header_text(self, name: str, about: Sequence[str], real: str) -> str:
        """Return the C header, which begins with the paragraphs `about`; other arguments as for `source_text`."""
        form = textwrap.TextWrapper(110, initial_indent=" * ", subsequent_indent=" *   ", break_on_hyphens=False)
        comment, guard = "\n".join(map(form.fill, about)), f"{name.upper()}_H"
        members = [("memory", self.ports[0])] + ([("torque", self.ports[2])] if self.words is LAW else [])
        members += self.large.items()
        rows = "\n".join(f"{_INDENT}{real} {member}[{max(size, 1)}];" for member, size in members)
        return f"""/*
{comment}
 */
#ifndef {guard}
#define {guard}

#include <float.h>

#if FLT_EVAL_METHOD != 0
#error "numbers must be rounded to their type: on x86 compile with -msse2 -mfpmath=sse"
#endif
#ifdef __FAST_MATH__
#error "operations must stay as they are written: compile without -ffast-math"
#endif

#ifdef __cplusplus
extern "C" {{
#endif

typedef struct {{
{rows}
}} {name}_state;

void {name}_init({name}_state *state);

{self._head(name, real)};

#ifdef __cplusplus
}}
#endif

#endif
"""

    def _head(self, name: str, real: str) -> str:
        (given, result), (_, numbers, results) = self.words, self.ports
        return f"int {name}_step({name}_state *state, const {real} {given}[{numbers}], {real} {result}[{results}])"


def program_of(policy: Policy, *, limits_given: bool = False) -> Recorded:
    """Return the program of a policy; `Unsupported` if it has no law, its tables are too large, or C cannot express it.

    With `limits_given`, the memory begins with the torque limits [N m].
    """
    law, joints = law_of(policy), policy.joints
    if law is None:
        raise Unsupported(
            f"{type(policy).__name__} has no law that can be exported; derive the class from "
            "fuzzyarm.fuzzy_policy.law.LawPolicy (see docs/contributing/add.md)"
        )
    numbers = sum(table.size for table in law.tables)
    if numbers > _LARGEST:
        raise Unsupported(f"it has {numbers} numbers in its tables or layers; allowed: at most {_LARGEST}")
    names = [f"{part}{joint + 1}" for part in Observation._fields for joint in range(joints)]
    command, constants = within_limits(law, joints, policy.integral_at), law.constants
    limit = tuple(policy.torque_limit.tolist())

    def step(seen: Any, memory: Any, *tables: Any) -> tuple[Any, Any]:
        if not limits_given:
            return command(memory, seen, (constants, limit), *tables)
        given, own = memory
        after, torque = command(own, seen, (constants, given), *tables)
        return (given, after), torque

    memory = (limit, law.memory) if limits_given else law.memory
    source = f"{law.act.__module__.partition('.')[2]}.{law.act.__name__}"
    return Recorded(step, (names, seen_by(joints)), memory, joints, LAW, source, law.tables)


_, *_SECTIONS = re.split(r"\n/\* @@ (\w+) \*/\n", Path(__file__).with_name("functions.c").read_text(encoding="utf-8"))
_HELPERS = dict(zip(_SECTIONS[::2], _SECTIONS[1::2], strict=True))
"""For each operation, the C function that replaces that of the math library; `floor` needs `rint`."""


def _helper_text(operation: str, real: str) -> str:
    """Return the C function of an operation, a key of `_HELPERS`; `real` is "double" or "float"."""
    literal = functools.partial(_literal_of, real=real)
    digits, steps, epsilon = {"double": (53, 9, "DBL"), "float": (24, 6, "FLT")}[real]
    exponents = [2**step for step in range(steps, 0, -1)]
    lift = 2 * (digits // 2 + 1)
    numbers = {
        **{"zero": 0.0, "half": 0.5, "one": 1.0, "two": 2.0, "four": 4.0, "large": 2.0 ** (digits - 1)},
        **{"split": 2.0 ** (digits - digits // 2) + 1.0, "lift": 2.0**lift, "drop": 2.0 ** (-lift // 2)},
    }
    lists = {"powers": [2.0**one for one in exponents], "roots": [2.0 ** (one // 2) for one in exponents]}
    form = textwrap.TextWrapper(100, initial_indent=" " * 8, subsequent_indent=" " * 8, break_on_hyphens=False)
    texts = {
        **{"real": real, "steps": str(steps), "epsilon": epsilon},
        **{name: form.fill(", ".join(map(literal, those))) for name, those in lists.items()},
        **{name: literal(number) for name, number in numbers.items()},
    }
    return _marked(_HELPERS[operation], texts)


def _marked(text: str, marks: Mapping[str, str]) -> str:
    return re.sub(r"@(\w+)@", lambda mark: marks[mark[1]], text)


def _zeroed(array: str, size: int, zero: str) -> str:
    head = f"{_INDENT}for (int k = 0; k < {max(size, 1)}; k++) {{"
    return f"{head}\n{_INDENT * 2}state->{array}[k] = {zero};\n{_INDENT}}}"


_LONGEST = 70  # most characters of an operation that is written at its use
_INDENT, _WIDTH = "    ", 110
_FORMS = {
    **{name: f"{{}} {name} {{}}" for name in ("+", "-", "*", "/", "<", "<=", ">", ">=", "==", "!=")},
    **{"&": "{} && {}", "|": "{} || {}", "select": "{} ? {} : {}", "neg": "-{}", "not": "!{}"},
}
_LOOSE = {*_FORMS, "real"} - {"not"}  # operations whose text needs brackets as an operand


def _literal_of(number: float, real: str) -> str:
    """Return a number as C text; if too small for "float", the smallest normal number, since it guards a division."""
    if not math.isfinite(number):  # C99 has no literal for it
        top = _literal_of(0.0 if math.isnan(number) else math.copysign(1.0, number), real)
        return f"({top} / {_literal_of(0.0, real)})"
    smallest = float(np.finfo(np.float32).tiny) if real == "float" else 0.0
    if 0.0 < abs(number) < smallest:
        number = math.copysign(smallest, number)
    text = repr(float(number)) + ("f" if real == "float" else "")
    return f"({text})" if text.startswith("-") else text


class _Uses:
    """The symbols needed by the outputs of a program, and where they are used."""

    def __init__(self, program: Program, outputs: Iterable[Any]) -> None:
        """Find the symbols from which the outputs and the memory that is kept between steps are computed."""
        # For each needed symbol, the regions where it is used; None where its text must be a name.
        self.regions: dict[Symbol, list[Region | None]] = defaultdict(list)
        self.read = {"room"}  # the memories from which numbers are needed, and the kept one
        self._from: dict[Symbol, list[tuple[Any, Region | None]]] = {}
        self._stored: dict[str, list[tuple[Any, Region]]] = defaultdict(list)
        self._conditions: dict[Region, Any] = {}
        self._items(program.top)
        todo: list[tuple[Any, Region | None]] = [(one, program.top) for one in outputs]
        todo += self._writes("room")
        while todo:
            one, where = todo.pop()
            if not isinstance(one, Symbol):
                continue
            seen = one in self.regions
            self.regions[one].append(where)
            if seen:
                continue
            todo += self._from.get(one, [(operand, one.region) for operand in one.operands])
            todo += self._decided(one.region)
            if one.operation == "load" and one.detail[0] not in self.read:
                self.read.add(one.detail[0])
                todo += self._writes(one.detail[0])

    def _items(self, region: Region) -> None:
        for item in region.items:
            if isinstance(item, Store):
                self._stored[item.memory].append((item.value, region))
            elif isinstance(item, Loop):
                for start, inside, end, after in zip(item.start, item.inside, item.end, item.after, strict=True):
                    self._from[inside], self._from[after] = [(start, None), (end, None)], [(inside, None)]
            elif isinstance(item, Branch):
                self._conditions[item.region] = item.condition
                for then, otherwise, after in zip(item.then, item.otherwise, item.after, strict=True):
                    self._from[after] = [(item.condition, region), (then, item.region), (otherwise, region)]
            if not isinstance(item, Symbol | Store):
                self._items(item.region)

    def _writes(self, memory: str) -> list[tuple[Any, Region | None]]:
        return [need for value, where in self._stored[memory] for need in ((value, where), *self._decided(where))]

    def _decided(self, region: Region | None) -> list[tuple[Any, Region | None]]:
        """Return (condition, None) for each condition that decides whether a region is run.

        None, as in `regions`, says that the C text of the condition must be a name.
        """
        if region is None:
            return []
        own: list[tuple[Any, Region | None]] = [(self._conditions[region], None)] if region in self._conditions else []
        return own + self._decided(region.parent)


class _CWriter:
    def __init__(self, of: Recorded, real: str) -> None:
        """Set up the writer of the C text of a recorded program; `real` is "double" or "float"."""
        self.used, self.tables = set[Any](), set[int]()  # used names of `_HELPERS` and functions; used tables
        self._of, self._real = of, real
        self._texts: dict[Symbol, str] = {}
        self._called: dict[Any, list[str]] = {}

    def step(self) -> list[str]:
        """Return the C lines in the body of the program's step function."""
        program, (given_word, result_word) = self._of, self._of.words
        memory, given, results = program.ports
        places = [f"state->memory[{k}]" for k in range(memory)] + [f"{given_word}[{k}]" for k in range(given)]
        names = [*(f"memory{k}" for k in range(memory)), *program.names]
        inputs = dict(zip(program.inputs, zip(names, places, strict=True), strict=False))
        targets = [f"{place} = {{}};" for place in (*places, *(f"{result_word}[{k}]" for k in range(results)))]
        changed = [
            (target, out)
            for place, (target, out, own) in enumerate(zip(targets, program.outputs, program.inputs, strict=True))
            if out is not own and place not in program.cells
        ]
        return self._lines(program, inputs, changed)

    def function(self, one: _Function) -> str:
        """Return the C definition of a function that is called, not inlined."""
        given, results = one.program.ports
        inputs = {one.program.inputs[k]: (name, "") for k, name in one.parameters}
        names = [f"{self._real} {name}" for _, name in one.parameters]
        names += [f"{self._real} *result{k}" for k in range(results)] if results > 1 else [] if names else ["void"]
        targets = [f"*result{k} = {{}};" for k in range(results)] if results > 1 else ["return {};"]
        lines = self._lines(one.program, inputs, list(zip(targets, one.program.outputs[given:], strict=True)))
        kind = "void" if results > 1 else self._real
        head = _wrapped([f"static {kind} {one.name}({names[0]}", *names[1:]], "", _INDENT)
        return "\n".join([*head[:-1], f"{head[-1]})", "{", *lines, "}", ""])

    def _lines(
        self, program: Program, inputs: dict[Symbol, tuple[str, str]], outputs: Sequence[tuple[str, Any]]
    ) -> list[str]:
        """Return the C lines in the body of a function.

        `inputs` gives, for each input, its C name and the expression from which it is read, or "" if this variable
        exists already. `outputs` are pairs of a statement, with {} as the placeholder for a number, and that number.
        """
        self._uses, self._names = _Uses(program, [out for _, out in outputs]), 0
        self._large = self._of.large if program is self._of else {}
        lines = [
            f"{_INDENT}{self._real} array{k}[{max(size, 1)}];"
            for k, size in enumerate(program.arrays)
            if f"array{k}" in self._uses.read - self._large.keys()
        ]
        for own, (name, place) in inputs.items():
            self._texts[own] = name
            lines += [f"{_INDENT}const {self._real} {name} = {place};"] if place and own in self._uses.regions else []
        lines += self._region(program.top, _INDENT)
        return lines + [_INDENT + text.format(_bare(self._text(out))) for text, out in outputs]

    def _region(self, region: Region, indent: str) -> list[str]:
        lines: list[str] = []
        for item in region.items:
            if isinstance(item, Symbol):
                lines += self._operation(item, indent) if item in self._uses.regions else []
            elif isinstance(item, Store):
                if item.memory in self._uses.read:
                    place = self._place(item.memory, item.place.constant, item.place.terms.items())
                    lines.append(f"{indent}{place} = {_bare(self._text(item.value))};")
            elif isinstance(item, For):
                if inside := self._region(item.region, indent + _INDENT):
                    rounds = _index(item.rounds.constant, item.rounds.terms.items())
                    i = f"i{item.number}"
                    lines += [f"{indent}for (int {i} = 0; {i} < {rounds}; {i}++) {{", *inside, f"{indent}}}"]
            else:
                lines += self._loop(item, indent) if isinstance(item, Loop) else self._branch(item, indent)
        return lines

    def _operation(self, one: Symbol, indent: str) -> list[str]:
        if one.operation == "call" and one.detail[0].program.ports[1] > 1:
            return self._call(one, indent)
        text = self._expression(one)
        if self._uses.regions[one] == [one.region] and len(text) <= _LONGEST and one.operation != "load":
            self._texts[one] = f"({text})" if one.operation in _LOOSE else text
            return []
        name = self._named(one)
        return [f"{indent}const {self._kind(one)} {name} = {text};"]

    def _call(self, one: Symbol, indent: str) -> list[str]:
        """Return the C lines of the call whose several results include `one`; empty if it was written before."""
        function, number = one.detail
        texts, lines = [_bare(self._text(operand)) for operand in one.operands], list[str]()
        key = (function.name, one.region, *texts)
        if key not in self._called:
            self.used.add(function.name)
            self._called[key] = names = [self._name("v") for _ in range(function.program.ports[1])]
            call = _wrapped([*texts, *(f"&{name}" for name in names)], f"{indent}{function.name}(", indent + _INDENT)
            lines = [*(f"{indent}{self._real} {name};" for name in names), *call[:-1], f"{call[-1]});"]
        self._texts[one] = self._called[key][number]
        return lines

    def _kind(self, one: Symbol) -> str:
        return "_Bool" if one.kind == "truth" else self._real

    def _named(self, one: Symbol) -> str:
        return self._texts.setdefault(one, self._name("v"))

    def _name(self, letter: str) -> str:
        self._names += 1
        return f"{letter}{self._names}"

    def _loop(self, loop: Loop, indent: str) -> list[str]:
        """Return the C lines of a loop; the numbers that it carries are assigned after all next values are computed."""
        if isinstance(loop.count, Symbol):
            raise Unsupported(f"{self._of.source} has a loop whose number of iterations is known only at run time")
        parts = zip(loop.start, loop.inside, loop.end, loop.after, strict=True)
        carried = [part for part in parts if part[1] in self._uses.regions]
        lines, within = list[str](), indent + _INDENT
        for start, inside, _, after in carried:
            text = self._text(start)
            self._texts[after] = name = self._named(inside)
            lines.append(f"{indent}{self._real} {name} = {_bare(text)};")
        inner, assigned = self._region(loop.region, within), list[str]()
        if not (inner or carried):
            return []
        own = {inside for _, inside, *_ in carried}
        for _, inside, end, _ in carried:
            if end is inside:
                continue
            text = self._text(end)
            if end in own:  # a variable that may be assigned before it is read here
                inner.append(f"{within}const {self._real} {(copy := self._name('v'))} = {text};")
                text = copy
            assigned.append(f"{within}{self._texts[inside]} = {_bare(text)};")
        i = self._name("n")
        head = f"{indent}for (int {i} = 0; {i} < {int(loop.count)}; {i}++) {{"
        return [*lines, head, *inner, *assigned, f"{indent}}}"]

    def _branch(self, branch: Branch, indent: str) -> list[str]:
        parts = zip(branch.then, branch.otherwise, branch.after, strict=True)
        merged = [part for part in parts if part[2] in self._uses.regions]
        inside = self._region(branch.region, indent + _INDENT)
        if not inside:
            condition = self._text(branch.condition) if merged else ""
            return [
                f"{indent}const {self._kind(after)} {self._named(after)} = "
                f"{condition} ? {self._text(then)} : {self._text(otherwise)};"
                for then, otherwise, after in merged
            ]
        texts = [(self._text(then), self._text(otherwise), self._named(after)) for then, otherwise, after in merged]
        lines = [f"{indent}{self._real} {name};" for *_, name in texts]
        lines += [f"{indent}if ({_bare(self._text(branch.condition))}) {{", *inside]
        lines += [f"{indent}{_INDENT}{name} = {_bare(then)};" for then, _, name in texts]
        others = [f"{indent}{_INDENT}{name} = {_bare(other)};" for _, other, name in texts]
        lines += [f"{indent}}} else {{", *others] if others else []
        return [*lines, f"{indent}}}"]

    def _expression(self, one: Symbol) -> str:
        name, texts = one.operation, [self._text(operand, one) for operand in one.operands]
        if name in _FORMS:
            return _FORMS[name].format(*texts)
        if name == "load":
            memory, constant, terms = one.detail
            return self._place(memory, constant, terms)
        if name == "call":
            self.used.add(one.detail[0].name)
            return f"{one.detail[0].name}({', '.join(map(_bare, texts))})"
        if name in ("row", "entry"):
            table, constant, terms = one.detail if name == "entry" else (*one.detail, ())
            self.used.add("place")
            self.tables.add(table.number)
            row = f"place_({_bare(texts[0])}, {table.shape[0] - 1}) * {table.columns}"
            return f"table{table.number}[({row}) + {_index(constant, terms)}]"
        if name == "index":
            return f"({self._real})({_index(*one.detail)})"
        if name == "real":
            return f"{texts[0]} ? {_literal_of(1.0, self._real)} : {_literal_of(0.0, self._real)}"
        if name not in _HELPERS:
            raise Unsupported(f"{self._of.source} computes {name!r}, an operation that cannot be written in C")
        self.used |= {name, "rint"} if name == "floor" else {name}
        return f"{name}_({_bare(texts[0])})"

    def _place(self, memory: str, constant: int, terms: Iterable[tuple[int, int]]) -> str:
        """Return the C text of an entry of an array or a table; `constant` and `terms` are as for `_index`."""
        if memory.startswith("table"):
            number = int(memory.removeprefix("table"))
            if not terms:
                return _literal_of(float(self._of.contents[number].flat[constant]), self._real)
            self.tables.add(number)
        kept = "memory" if memory == "room" else memory
        return f"{'state->' if memory == 'room' or memory in self._large else ''}{kept}[{_index(constant, terms)}]"

    def _text(self, operand: Any, user: Symbol | None = None) -> str:
        if isinstance(operand, Symbol):
            return self._texts[operand]
        if user is not None and user.operation in ("&", "|", "not"):
            return str(int(operand))
        return _literal_of(float(operand), self._real)


def _index(constant: int, terms: Iterable[tuple[int, int]]) -> str:
    """Return the C text of an index: `constant` plus factor times the loop's counter for each (loop, factor)."""
    parts = [f"i{loop}" if factor == 1 else f"({factor} * i{loop})" for loop, factor in terms if factor]
    rest = [str(constant)] if constant > 0 or not parts else []
    return " + ".join([*parts, *rest]) + (f" - {-constant}" if constant < 0 and parts else "")


def _wrapped(texts: Iterable[str], indent: str, further: str) -> list[str]:
    """Return `texts`, separated by commas, as lines of at most `_WIDTH` characters.

    `indent` begins the first line, `further` every later line.
    """
    form = textwrap.TextWrapper(_WIDTH, indent, further, break_long_words=False, break_on_hyphens=False)
    return [line.replace("\0", " ") for line in form.wrap(", ".join(text.replace(" ", "\0") for text in texts))]


def _bare(text: str) -> str:
    """Return a text without the brackets that enclose the whole text."""
    depths = itertools.accumulate({"(": 1, ")": -1}.get(mark, 0) for mark in text[1:-1])
    return text[1:-1] if text.startswith("(") and text.endswith(")") and min(depths, default=0) >= 0 else text


def _table(number: int, array: np.ndarray, real: str) -> str:
    lines = [f"{_INDENT}static const {real} table{number}[{array.size}] = {{"]
    for row in array.reshape(len(array), -1) if array.ndim > 1 else [array]:
        texts = (_literal_of(one, real).strip("()") for one in row.tolist())
        lines += _wrapped((*texts, ""), _INDENT * 2, _INDENT * 2)
    return "\n".join([*lines[:-1], lines[-1].rstrip(", "), f"{_INDENT}}};"])
