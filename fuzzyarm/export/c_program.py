"""The program of a policy: its law run on values, and the C source of that."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.observation import Observation
from fuzzyarm.export.c_text import HELPERS, ROLLED, Writer, helper_text, wrapped
from fuzzyarm.export.trace import Block, Scalar, Trace, Unsupported
from fuzzyarm.fuzzy_policy.law import law_of, seen_by, within_limits
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import RECORDERS, flat, like

__all__ = [
    "LAW", "MODEL", "MOST_REMEMBERED", "Program", "Words", "arguments_text", "program_of", "recorded", "source_text",
]  # fmt: skip

MOST_REMEMBERED = 2000
"""Most numbers that an exported law remembers: its loops are written out."""


class Words(NamedTuple):
    """What the arrays of a program's step are called in C: the one that is given and the one that is filled."""

    given: str
    result: str


LAW = Words("observation", "torque")
"""The words of a law."""
MODEL = Words("input", "output")
"""The words of a model of a co-simulation."""


@dataclasses.dataclass(frozen=True)
class Program:
    """What a policy or a plant does in a control step, recorded.

    Attributes:
        trace: with the functions and tables.
        block: the step.
        memory: what every number of the memory becomes.
        result: numbers that the step returns: torques of every motor [N m] of a policy.
        inputs: how many numbers are given: those of an observation.
        sources: the functions of the package that it is made from, by name.
        words: what the arrays are called.
    """

    trace: Trace
    block: Block
    memory: tuple[Scalar, ...]
    result: tuple[Scalar, ...]
    inputs: int
    sources: tuple[str, ...]
    words: Words


def program_of(policy: Policy) -> Program:
    """Return the program of a policy.

    Raises:
        Unsupported: it has no law, its law has something that cannot be written in C, or it remembers too much.
    """
    if policy.memory_size > MOST_REMEMBERED:
        raise Unsupported(
            f"it remembers {policy.memory_size} numbers, and loops over more than {MOST_REMEMBERED} are too long to be "
            "written out"
        )
    law, joints = law_of(policy), policy.joints
    if law is None:
        raise Unsupported(
            f"{type(policy).__name__} has no law that can be written as C; make it a `LawPolicy` (docs: add a policy)"
        )
    names = [f"{part}{joint + 1}" for part in Observation._fields for joint in range(joints)]
    command, tables = within_limits(law, joints, policy.integral_at), [table.astype(object) for table in law.tables]
    given = law.constants, tuple(policy.torque_limit.tolist())

    def step(numbers: Any, memory: Any) -> tuple[Any, Any]:
        return command(memory, like(seen_by(joints), iter(numbers)), given, *tables)

    return recorded(step, names, law.memory, LAW, f"{law.act.__module__.partition('.')[2]}.{law.act.__name__}")


def recorded(
    step: Callable[[Any, Any], tuple[Any, Any]], given: Sequence[str], memory: Any, words: Words, source: str
) -> Program:
    """Return the program of ``step(numbers, memory)``, which returns memory and result.

    Args:
        step: a function of numbers.
        given: names of the numbers that are given.
        memory: a tree of zeros, and `Cells`.
        words: what the arrays are called in C.
        source: the name of the function that it is made of.

    Raises:
        Unsupported: the function has something that cannot be written in C.
    """
    trace = Trace()
    seen = [trace.input(f"{words.given}[{k}]", name=name) for k, name in enumerate(given)]
    held = [trace.input(f"state->memory[{k}]", name=f"memory{k}") for k in range(len(flat(memory)))]
    remembered = like(memory, iter(held))
    trace.arrays += _arrays(remembered)
    RECORDERS.append(trace)
    try:
        after, result = step(seen, remembered)
    except TypeError as error:
        raise Unsupported(f"{source} does something with a number that is not known: {error}") from error
    finally:
        RECORDERS.pop()
    sources = (source, *(f"{name}" for name in trace.functions))
    return Program(trace, trace.block, tuple(_numbers(after)), tuple(result), len(given), sources, words)


def _numbers(tree: Any) -> list[Any]:
    """Return the numbers of nested tuples and arrays, in order."""
    if isinstance(tree, tuple):
        return [number for part in tree for number in _numbers(part)]
    return tree.ravel().tolist() if isinstance(tree, np.ndarray) else [tree]


def _arrays(tree: Any) -> list[np.ndarray]:
    if isinstance(tree, tuple):
        return [array for part in tree for array in _arrays(part)]
    return [tree] if isinstance(tree, np.ndarray) else []


def source_text(program: Program, name: str, real: str) -> str:
    """Return the C source of a program.

    Args:
        program: of a policy.
        name: what its functions, its struct and its header begin with.
        real: "double" or "float".
    """
    functions, taken = program.trace.functions, set(program.trace.functions) | set(program.trace.tables)
    writer = Writer(real, taken)
    outputs = [(f"{program.words.result}[{k}] = {{}};", value) for k, value in enumerate(program.result)]
    outputs += [(f"state->memory[{k}] = {{}};", value) for k, value in enumerate(program.memory)]
    lines = writer.body(program.block, outputs)
    used, texts = set(writer.used), list[str]()
    for function in reversed(list(functions.values())):  # a function calls only those before it
        if function.name in used:
            inner = Writer(real, taken)
            texts.insert(0, inner.function(function))
            used |= inner.used
    helpers = [helper_text(operation, real, writer.literal) for operation in HELPERS if operation in used]
    helpers += [text.format(real=real) for name, text in ROLLED.items() if name in used]
    tables = [_table(table, array, writer, real) for table, array in program.trace.tables.items()]
    arguments = arguments_text(program, name, real)
    unused = [] if program.memory else ["    (void)state;"]
    step = "\n".join([f"void {name}_step({arguments})", "{", *tables, *unused, *lines, "}", ""])
    text = "\n".join([f'#include "{name}.h"', "", _init(program, name, writer), *helpers, *texts, step])
    own = "|".join(re.findall(r"^static \w+ (\w+)\(", text, re.MULTILINE))
    return re.sub(rf"\b({own})\(", rf"{name}_part_\1(", text) if own else text  # several programs go into one file


def arguments_text(program: Program, name: str, real: str) -> str:
    """Return the arguments of a program's step in C; name and real as for `source_text`."""
    words, count = program.words, len(program.result)
    return f"{name}_state *state, const {real} {words.given}[{program.inputs}], {real} {words.result}[{count}]"


def _table(name: str, array: np.ndarray, writer: Writer, real: str) -> str:
    lines = [f"    static const {real} {name}[{len(array)}][{array.shape[1]}] = {{"]
    for row in array:
        lines += ["        {", *wrapped((writer.literal(number).strip("()") for number in row), " " * 12), "        },"]
    return "\n".join([*lines[:-1], "        }", "    };"])


def _init(program: Program, name: str, writer: Writer) -> str:
    count = max(len(program.memory), 1)
    lines = [
        f"void {name}_init({name}_state *state)",
        "{",
        "    int k;",
        f"    for (k = 0; k < {count}; k++) {{",
        f"        state->memory[k] = {writer.literal(0.0)};",
        "    }",
        "}",
    ]
    return "\n".join([*lines, ""])
