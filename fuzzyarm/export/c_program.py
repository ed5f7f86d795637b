"""The program of a policy: its `command` executed on values, and the C source of that."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from fuzzyarm.envs.observation import PARTS, Observation
from fuzzyarm.envs.physics.elementwise import gaussian, sine_cosine
from fuzzyarm.envs.physics.friction import stick_slip
from fuzzyarm.export.c_helpers import HELPERS, helper_text
from fuzzyarm.export.c_text import Writer, wrapped
from fuzzyarm.export.loops import ROLLED, loops_text
from fuzzyarm.export.partial import Interpreter
from fuzzyarm.export.trace import UNKNOWN, Block, Scalar, Trace, Unsupported
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.functions import area_sine, hyperbolic_tangent, logistic

__all__ = ["Program", "program_of", "source_text"]

APART = (sine_cosine, gaussian, stick_slip, hyperbolic_tangent, logistic, area_sine)
"""What becomes functions of the program rather than part of its step."""


@dataclasses.dataclass(frozen=True)
class Program:
    """What a policy does in a control step, recorded.

    Attributes:
        trace: with the functions and tables.
        block: the step.
        memory: what every number of the memory becomes.
        torque: of every motor [N m].
        inputs: how many numbers an observation has.
        sources: the functions of the package that it is made from, by name.
    """

    trace: Trace
    block: Block
    memory: tuple[Scalar, ...]
    torque: tuple[Scalar, ...]
    inputs: int
    sources: tuple[str, ...]


def program_of(policy: Policy) -> Program:
    """Return the program of a policy.

    Raises:
        Unsupported: its source has something that cannot be written in C.
    """
    own, joints = Interpreter(APART), policy.joints
    names = [f"{part}{joint + 1}" for part in Observation._fields for joint in range(joints)]
    seen: list[Any] = [own.trace.input(f"observation[{k}]", name=name) for k, name in enumerate(names)]
    held: list[Any] = [own.trace.input(f"state->memory[{k}]", name=f"memory{k}") for k in range(policy.memory_size)]
    observation, memory = (own.array(_row(entries)) for entries in (seen, held))
    torque = own.array(_row([UNKNOWN] * joints))
    try:
        own.call(policy.command, (observation, memory, torque))
    except TypeError as error:  # a number that is not known, where Python needs a known one
        raise Unsupported(f"{type(policy).__name__} uses a number that is not known as {error}") from error
    return Program(own.trace, own.trace.block, tuple(memory[0]), tuple(torque[0]), PARTS * joints, tuple(own.called))


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
    outputs = [(f"torque[{k}] = {{}};", value) for k, value in enumerate(program.torque)]
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
    arguments = f"{name}_state *state, const {real} observation[{program.inputs}], {real} torque[{len(program.torque)}]"
    step = "\n".join([f"void {name}_step({arguments})", "{", *tables, *lines, "}", ""])
    return "\n".join([f'#include "{name}.h"', "", _init(program, name, writer), *helpers, *texts, step])


def _table(name: str, array: np.ndarray, writer: Writer, real: str) -> str:
    lines = [f"    static const {real} {name}[{len(array)}][{array.shape[1]}] = {{"]
    for row in array:
        lines += ["        {", *wrapped((writer.literal(number).strip("()") for number in row), " " * 12), "        },"]
    return "\n".join([*lines[:-1], "        }", "    };"])


def _init(program: Program, name: str, writer: Writer) -> str:
    count = len(program.memory)
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
