"""A policy as ONNX: observation and memory in, torque and memory out, for any number of lanes, in double precision.

A lane is one arm. The graph has the operations of the recorded program from which C is also written. Loops are
unrolled; both sides of a branch are computed, and each lane selects its own. onnxruntime gives the policy's values,
except that its Where returns 0 for -0.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm import __version__
from fuzzyarm.common.checks import instance, path_of
from fuzzyarm.common.files import write_once
from fuzzyarm.export._c_text import LARGEST, Recorded, Unsupported, program_of
from fuzzyarm.export.c_files import c_name, certificate_lines
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.symbols import Branch, For, Index, Region, Store, Symbol

__all__ = ["export_onnx"]

_MOST = 200_000  # operations; a runtime takes a minute to load this many
_OPSET, _IR = 17, 8  # read by onnxruntime since 2022
_DOUBLE, _INT64 = 11, 7  # types of elements, see onnx.TensorProto
_OPERATORS: dict[str, tuple[str, Any]] = {
    **{"+": ("Add", np.add), "-": ("Sub", np.subtract), "*": ("Mul", np.multiply), "/": ("Div", np.divide)},
    **{"<": ("Less", np.less), "<=": ("LessOrEqual", np.less_equal), "==": ("Equal", np.equal)},
    **{">": ("Greater", np.greater), ">=": ("GreaterOrEqual", np.greater_equal)},
    **{"&": ("And", np.logical_and), "|": ("Or", np.logical_or), "not": ("Not", np.logical_not)},
    **{"neg": ("Neg", np.negative), "abs": ("Abs", np.abs), "sqrt": ("Sqrt", np.sqrt)},
    **{"floor": ("Floor", np.floor), "rint": ("Round", np.rint)},
}
"""For each operation of a program, the ONNX operator and the NumPy function for known numbers."""
_OF_TRUTH = {"<", "<=", "==", ">", ">=", "&", "|", "not"}


def export_onnx(label: str, policy: Policy, folder: str | Path) -> Path:
    """Write a policy as NAME.onnx, named after its label, into a folder, which must exist; return the file.

    Inputs are `observation` (lanes, 5 n) [rad, rad/s, rad/s²] and `memory` (lanes, size), which must be zeros when
    an episode begins. Outputs are `torque` (lanes, n) [N m], `next_memory`, and `status` (lanes, 1), the return value
    of the step in C. The last n entries of the memory are the last torques.

    Raises:
        ValueError: the policy has no law or a law of too many operations, the package onnx is not installed, or the
            folder contains another file of this name.
        OSError: the file cannot be written.
    """
    folder, _ = path_of("folder", folder), instance("policy", policy, Policy)  # type: ignore[type-abstract]
    try:
        content = _Graph().model(instance("label", label, str), policy, program_of(policy))
    except Unsupported as error:
        raise ValueError(f"{label} cannot be written as ONNX: {error}") from None
    return write_once(Path(folder), {f"{c_name(label)}.onnx": content})[0]


class _Graph:
    """A graph under construction; a number is a known float or boolean, or the name of a tensor (lanes, 1)."""

    def __init__(self) -> None:
        self.calls: dict[Any, list[Any]] = {}  # the results by function and arguments
        self._nodes: dict[Any, str] = {}  # output names by operator, inputs and attributes
        self._parts: dict[str, list[str]] = {}  # output names of nodes with several outputs, by node
        self._constants: dict[Any, tuple[str, np.ndarray]] = {}  # name and content by type, shape and bytes
        self._truths: set[str] = set()  # the names of booleans

    def model(self, label: str, policy: Policy, program: Recorded) -> bytes:
        """Return the content of the ONNX file: the law, and the checks that surround it in C (see ``functions.c``)."""
        try:
            from onnx import helper, numpy_helper
        except ImportError:
            raise ValueError(
                "onnx, which writes the file, is not installed; run in the repository: "
                'pip install -c constraints.txt -e ".[onnx]"'
            ) from None
        memory, seen, joints = program.ports
        before, given = self._columns("memory", memory + joints), self._columns("observation", seen)
        inside = self._node("LessOrEqual", self._node("Abs", "observation"), self._name(LARGEST))
        least = self._node("ReduceMin", self._node("Cast", inside, to=_DOUBLE), axes=(1,))
        good, finite = self.apply("==", least, 1.0), True
        found = _Run(self, program, [*before[:memory], *given, *[math.nan] * joints]).outputs
        for one in found[memory + seen :]:
            finite = self.apply("&", finite, self.apply("==", self.apply("-", one, one), 0.0))
        otherwise = [*[0.0] * memory, *before[memory:]]
        kept = [
            self.apply("select", good, self.apply("select", finite, new, other), old)
            for new, other, old in zip([*found[:memory], *found[memory + seen :]], otherwise, before, strict=True)
        ]
        status = self.apply("select", good, self.apply("select", finite, 0.0, 2.0), 1.0)
        parts = {"torque": kept[memory:], "next_memory": kept, "status": [status]}
        results = {name: [self._name(number) for number in numbers] for name, numbers in parts.items()}

        def tensor(name: str, size: int) -> Any:
            return helper.make_tensor_value_info(name, _DOUBLE, ["lanes", size])

        used = {name for names in results.values() for name in names}
        graph = helper.make_graph(
            [
                *self._needed(used),
                *(helper.make_node("Concat", names, [name], axis=1) for name, names in results.items()),
            ],
            c_name(label),
            [tensor("observation", seen), tensor("memory", memory + joints)],
            [tensor(name, len(names)) for name, names in results.items()],
            [numpy_helper.from_array(array, name) for name, array in self._constants.values() if name in used],
            doc_string="\n".join([f"Policy {label} of {joints} joints.", *certificate_lines(policy)]),
        )
        made = {"producer_name": "fuzzyarm", "producer_version": __version__, "ir_version": _IR}
        content: bytes = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", _OPSET)], **made
        ).SerializeToString()
        return content

    def apply(self, operation: str, *operands: Any) -> Any:
        """Return the result of a program's operation: a number if it is known, else the name of its tensor."""
        if operation == "!=":
            return self.apply("not", self.apply("==", *operands))
        if operation == "select":
            return self._selected(*operands)
        known = not any(isinstance(one, str) for one in operands)
        if operation == "real":
            return float(operands[0]) if known else self._node("Cast", *operands, to=_DOUBLE)
        if operation not in _OPERATORS:
            raise Unsupported(f"it computes {operation!r}, an operation that cannot be written as an ONNX operator")
        operator, function = _OPERATORS[operation]
        if known:
            with np.errstate(all="ignore"):
                return function(*operands).item()
        if operation in ("&", "|") and len(names := [one for one in operands if isinstance(one, str)]) == 1:
            (truth,) = (one for one in operands if not isinstance(one, str))
            return names[0] if bool(truth) is (operation == "&") else truth
        name = self._node(operator, *map(self._name, operands))
        if operation in _OF_TRUTH:
            self._truths.add(name)
        return name

    def looked_up(self, column: np.ndarray, place: Any) -> Any:
        """Return a table column's entry at index `place`; outside the column, the nearest entry; for nan, the first."""
        last = float(len(column) - 1)
        within = self.apply("select", self.apply("<", place, last), place, last)
        row = self.apply("select", self.apply(">", place, 0.0), within, 0.0)
        if not isinstance(row, str):
            return float(column[int(row)])
        return self._node("Gather", self._name(column), self._node("Cast", row, to=_INT64))

    def _selected(self, condition: Any, first: Any, second: Any) -> Any:
        if not isinstance(condition, str):
            return first if condition else second
        if any(isinstance(one, bool) or one in self._truths for one in (first, second)):
            otherwise = self.apply("&", self.apply("not", condition), second)
            return self.apply("|", self.apply("&", condition, first), otherwise)
        return self._node("Where", condition, self._name(first), self._name(second))

    def _node(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Add a node, unless one has the same operator, inputs and attributes; return the name of its output."""
        if len(self._nodes) >= _MOST:
            raise Unsupported(f"with its loops unrolled, it has more than {_MOST:,} operations; export it as C instead")
        return self._nodes.setdefault((operator, inputs, tuple(attributes.items())), f"n{len(self._nodes)}")

    def _name(self, number: Any) -> str:
        """Return the name of a number in the graph; a known number becomes a constant."""
        if isinstance(number, str):
            return number
        array = np.asarray(number)
        key = (array.dtype.str, array.shape, array.tobytes())
        return self._constants.setdefault(key, (f"c{len(self._constants)}", array))[0]

    def _columns(self, of: str, count: int) -> list[str]:
        """Return the names of the `count` columns into which the input named `of` is split."""
        name = self._node("Split", of, self._name(np.ones(count, dtype=np.int64)), axis=1)
        self._parts[name] = [f"{name}_{k}" for k in range(count)]
        return self._parts[name]

    def _needed(self, names: set[str]) -> list[Any]:
        """Return the nodes from which `names` are computed, in order; add their inputs to `names`."""
        from onnx import helper

        nodes = list[Any]()
        for (operator, inputs, attributes), name in reversed(self._nodes.items()):
            outputs = self._parts.get(name, [name])
            if names.intersection(outputs):
                names.update(inputs)
                nodes.append(helper.make_node(operator, inputs, outputs, **dict(attributes)))
        return nodes[::-1]


class _Run:
    """A run of a program that adds nodes to a graph; `outputs` are the returned numbers or their tensors' names."""

    def __init__(self, graph: _Graph, program: Program, inputs: Sequence[Any]) -> None:
        self._graph, self._program = graph, program
        self._values: dict[Symbol, Any] = dict(zip(program.inputs, inputs, strict=True))
        self._memory = {f"array{k}": [math.nan] * size for k, size in enumerate(program.arrays)}
        self._memory["room"], self._rounds = list(inputs), dict[int, int]()
        self._region(program.top, True)
        self.outputs = [
            self._memory["room"][place] if place in program.cells else self._value(one)
            for place, one in enumerate(program.outputs)
        ]

    def _value(self, one: Any) -> Any:
        return self._values[one] if isinstance(one, Symbol) else one if isinstance(one, bool) else float(one)

    def _at(self, constant: int, terms: Iterable[tuple[int, int]]) -> int:
        return constant + sum(factor * self._rounds[loop] for loop, factor in terms)

    def _index(self, index: Index) -> int:
        return self._at(index.constant, index.terms.items())

    def _region(self, region: Region, runs: Any) -> None:
        """Run a region; `runs`, a boolean or a boolean's name, says whether the region's stores take effect."""
        for item in region.items:
            if isinstance(item, Symbol):
                self._values[item] = self._operation(item)
            elif isinstance(item, Store):
                numbers, place = self._memory[item.memory], self._index(item.place)
                numbers[place] = self._graph.apply("select", runs, self._value(item.value), numbers[place])
            elif isinstance(item, For):
                for k in range(self._index(item.rounds)):
                    self._rounds[item.number] = k
                    self._region(item.region, runs)
            elif isinstance(item, Branch):
                self._branch(item, runs)
            else:
                carried = [self._value(one) for one in item.start]
                for _ in range(int(item.count)):
                    self._values.update(zip(item.inside, carried, strict=True))
                    self._region(item.region, runs)
                    carried = [self._value(one) for one in item.end]
                self._values.update(zip(item.after, carried, strict=True))

    def _branch(self, branch: Branch, runs: Any) -> None:
        condition, otherwise = self._value(branch.condition), [self._value(one) for one in branch.otherwise]
        then = otherwise
        if condition is not False:
            self._region(branch.region, self._graph.apply("&", runs, condition))
            then = [self._value(one) for one in branch.then]
        for after, first, second in zip(branch.after, then, otherwise, strict=True):
            self._values[after] = self._graph.apply("select", condition, first, second)

    def _operation(self, one: Symbol) -> Any:
        operands, detail = [self._value(operand) for operand in one.operands], one.detail
        if one.operation == "call":
            return self._called(detail[0], operands)[detail[1]]
        if one.operation == "index":
            return float(self._at(*detail))
        if one.operation == "load":
            memory, place = detail[0], self._at(*detail[1:])
            return self._memory[memory][place] if memory in self._memory else self._table(memory).flat[place].item()
        if one.operation in ("row", "entry"):
            table, column = detail[0], self._at(detail[1], detail[2] if one.operation == "entry" else ())
            content = self._table(f"table{table.number}").reshape(-1, table.columns)
            return self._graph.looked_up(content[:, column], *operands)
        return self._graph.apply(one.operation, *operands)

    def _table(self, memory: str) -> np.ndarray:
        contents: Sequence[np.ndarray] = getattr(self._program, "contents", ())
        return contents[int(memory.removeprefix("table"))]

    def _called(self, function: Any, operands: list[Any]) -> list[Any]:
        """Return the results of a function that the program calls, added to the graph once for the same arguments."""
        key = (function.name, *map(repr, operands))
        if key not in self._graph.calls:
            given, results = function.program.ports
            inputs: list[Any] = [math.nan] * (given + results)
            for (place, _), number in zip(function.parameters, operands, strict=True):
                inputs[place] = number
            self._graph.calls[key] = _Run(self._graph, function.program, inputs).outputs[given:]
        return self._graph.calls[key]
