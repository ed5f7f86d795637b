"""The program of a policy: its `command` executed on values, and the C source of that."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.elementwise import gaussian, sine_cosine
from fuzzyarm.envs.physics.friction import stick_slip
from fuzzyarm.envs.physics.integrator import step
from fuzzyarm.export.c_helpers import HELPERS, helper_text
from fuzzyarm.export.c_text import Writer, wrapped
from fuzzyarm.export.loops import ROLLED, loops_text
from fuzzyarm.export.partial import Interpreter
from fuzzyarm.export.refusals import Unsupported
from fuzzyarm.export.trace import UNKNOWN, Block, Scalar, Trace
from fuzzyarm.fuzzy_policy.law import Law, law_of, seen_by, within_limits
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.functions import area_sine, hyperbolic_tangent, logistic
from fuzzyarm.numbers.functions import flat, like

__all__ = [
    "LAW", "MODEL", "MOST_REMEMBERED", "Program", "Words", "arguments_text", "program_of", "recorded", "source_text",
]  # fmt: skip

MOST_REMEMBERED = 2000
"""Most numbers that an exported law remembers: its loops are written out."""

APART = (sine_cosine, gaussian, stick_slip, hyperbolic_tangent, logistic, area_sine, step)
"""What becomes functions of the program rather than part of its step."""


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
        Unsupported: its source has something that cannot be written in C, or it remembers too much.
    """
    if policy.memory_size > MOST_REMEMBERED:
        raise Unsupported(
            f"it remembers {policy.memory_size} numbers, and loops over more than {MOST_REMEMBERED} are too long to be "
            "written out"
        )
    joints = policy.joints
    names = [f"{part}{joint + 1}" for part in Observation._fields for joint in range(joints)]
    law = law_of(policy)
    if law is None:
        return recorded(policy.command, names, policy.memory_size, joints, LAW)
    return _recorded_law(law, policy, names)


def _recorded_law(law: Law, policy: Policy, names: Sequence[str]) -> Program:
    """Return the program of a law within its limits."""
    own = Interpreter(APART)
    seen = [own.trace.input(f"{LAW.given}[{k}]", name=name) for k, name in enumerate(names)]
    held = [own.trace.input(f"state->memory[{k}]", name=f"memory{k}") for k in range(policy.memory_size)]
    command = within_limits(law, policy.joints, policy.integral_at)
    given = law.constants, tuple(policy.torque_limit.tolist())
    memory, seen_by_joint = like(law.memory, iter(held)), like(seen_by(policy.joints), iter(seen))
    after, torque = command(memory, seen_by_joint, given, *law.tables)
    own.called.setdefault(f"{law.act.__module__.partition('.')[2]}.{law.act.__name__}")
    return Program(own.trace, own.trace.block, tuple(flat(after)), tuple(torque), len(names), tuple(own.called), LAW)


def recorded(
    command: Callable[..., Any], given: Sequence[str], memory_size: int, results: int, words: Words
) -> Program:
    """Return the program of ``command(given, memory, result)``, which takes arrays of one lane each.

    Args:
        command: reads `given` (1, numbers), changes `memory` (1, numbers) and fills `result` (1, numbers).
        given: names of the numbers that are given.
        memory_size: how many numbers are remembered.
        results: how many are returned.
        words: what the arrays are called in C.

    Raises:
        Unsupported: the source has something that cannot be written in C.
    """
    own = Interpreter(APART)
    seen: list[Any] = [own.trace.input(f"{words.given}[{k}]", name=name) for k, name in enumerate(given)]
    held: list[Any] = [own.trace.input(f"state->memory[{k}]", name=f"memory{k}") for k in range(memory_size)]
    numbers, memory = (own.array(_row(entries)) for entries in (seen, held))
    result = own.array(_row([UNKNOWN] * results))
    try:
        own.call(command, (numbers, memory, result))
    except TypeError as error:  # a number that is not known, where Python needs a known one
        name = getattr(command, "__qualname__", "it").partition(".")[0]
        raise Unsupported(f"{name} uses a number that is not known as {error}") from error
    return Program(own.trace, own.trace.block, tuple(memory[0]), tuple(result[0]), len(given), tuple(own.called), words)


def _row(entries: list[Any]) -> np.ndarray:
    row = np.empty((1, len(entries)), dtype=object)
    row[0, :] = entries
    return row


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
    helpers += [loops_text(function, real) for function in ROLLED if function.__name__ in used]
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
