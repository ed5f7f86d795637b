"""A recorded program as LLVM text, which loads, computes and stores the numbers of groups of arms.

Operations, loops and branches are written for one arm or for vectors of arms. No operation may be contracted or
reordered: the text has no flags that would allow it.
"""

import contextlib
import enum
import itertools
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.symbols import Branch, For, Loop, Region, Store, Symbol, Word

__all__ = ["EIGHT", "WIDE", "PortLayout", "kernel_text"]

_Number = tuple[int, int, int, str]  # port, index in the port, index among all numbers, and name of a number
EIGHT = 8  # numbers that are exchanged between vectors together
_EXCHANGED = {1: (0, 8, 2, 10, 4, 12, 6, 14), 2: (0, 1, 8, 9, 4, 5, 12, 13), 4: (0, 1, 2, 3, 8, 9, 10, 11)}
_BINARY = {
    "+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv", "<": "fcmp olt", "<=": "fcmp ole", ">": "fcmp ogt",
    ">=": "fcmp oge", "==": "fcmp oeq", "!=": "fcmp une", "&": "and", "|": "or",
}  # fmt: skip
_CALLED = {"abs": "fabs", "rint": "rint", "floor": "floor", "sqrt": "sqrt", "log": "log"}  # LLVM's functions
_OF_WORDS = {"+": "add", "*": "mul", "xor": "xor", "shift": "lshr"}
_CONVERTED = {"word": "bitcast", "whole": "fptosi", "number": "sitofp", "bits": "bitcast"}
_KINDS = {"real": "double", "truth": "i1", "word": "i64"}


def _row_of(item: Any) -> Any:
    """Return the pair (row, table) of a look-up, by which look-ups are grouped; None for other items."""
    if isinstance(item, Symbol) and item.operation == "row":
        return item.operands[0] if isinstance(item.operands[0], float) else id(item.operands[0]), item.detail[0]
    return None


def _literal(number: Any) -> str:
    return f"0x{struct.unpack('>Q', struct.pack('>d', float(number)))[0]:016X}"


WIDE = 16  # arms per vector if there are many


class PortLayout(enum.Enum):
    """The arrangement of a port's numbers in its array.

    `ROWS`: (arms, numbers), the numbers of an arm side by side; rows may have gaps. `COLUMNS`: (numbers, arms), the
    arms side by side. `BLOCKS`: (blocks, numbers, `WIDE`), `WIDE` arms in each block; the last one may have unused
    entries, which are also written.
    """

    ROWS = enum.auto()
    COLUMNS = enum.auto()
    BLOCKS = enum.auto()


class _Writer:
    """The writer of the LLVM text of a function that receives a job and computes its arms in groups of `width`.

    Each method adds lines, and some return the name of what these compute.
    """

    def __init__(self, program: Program, layouts: Sequence[PortLayout], width: int, *, repeated: bool) -> None:
        self.program, self.layouts, self.width = program, layouts, width
        self.repeated = repeated or bool(program.cells)
        self.masks = list[str]()
        self.places: list[dict[Any, str]] = [{}]
        self.lines, self.here, self.blocks, self.names = list[str](), "entry", 0, 0
        wide = f"<{width} x " if width > 1 else ""
        self.kinds = {kind: f"{wide}{one}>" if wide else one for kind, one in _KINDS.items()}
        self.real, self.truth, self.word = self.kinds.values()
        self.pointers = f"<{width} x ptr>"
        self.suffix = f".v{width}f64" if wide else ".f64"
        self.declared = set[str]()

    def put(self, line: str) -> None:
        """Append one indented line to the LLVM text."""
        self.lines.append("  " + line)

    def new(self, expression: str) -> str:
        """Append an instruction that computes an expression; return the new name of its result."""
        self.names += 1
        self.put(f"%w{self.names} = {expression}")
        return f"%w{self.names}"

    def call(self, kind: str, name: str, *arguments: tuple[str, str]) -> str:
        """Declare an LLVM function that returns a `kind`; return the text of a call with arguments (type, value)."""
        self.declared.add(f"declare {kind} @llvm.{name}({', '.join(of for of, _ in arguments)})")
        return f"call {kind} @llvm.{name}({', '.join(map(' '.join, arguments))})"

    def label(self, name: str) -> None:
        """Begin the basic block with this name."""
        self.lines.append(f"{name}:")
        self.here = name

    def block(self) -> str:
        """Return a new name for a basic block."""
        self.blocks += 1
        return f"block{self.blocks}"

    def splat(self, kind: str, text: str) -> str:
        """Return the text of a constant: for several arms, a vector in which each arm has the same entry."""
        return f"splat ({kind} {text})" if self.width > 1 else text

    def spread(self, out: str, kind: str, one: str) -> None:
        """Write the vector `out`, in which each entry is the number `one` of the LLVM type `kind`."""
        vector = f"<{self.width} x {kind}>"
        first = self.new(f"insertelement {vector} poison, {kind} {one}, i64 0")
        self.put(f"{out} = shufflevector {vector} {first}, {vector} poison, <{self.width} x i32> zeroinitializer")

    def of(self, operand: Any, *, uniform: bool = False) -> str:
        """Return the text of an operand: a vector with one number per arm, or a scalar if `uniform` and shared."""
        if isinstance(operand, Symbol):
            return f"%s{operand.number}" if operand.uniform and (uniform or self.width == 1) else f"%v{operand.number}"
        kind, text = ("i64", str(operand % 2**64)) if isinstance(operand, Word) else ("double", _literal(operand))
        return text if uniform else self.splat(kind, text)

    def operation(self, one: Symbol) -> None:
        """Write the LLVM instructions of one recorded operation."""
        uniform, name = one.uniform, one.operation
        kinds, suffix = (_KINDS, ".f64") if uniform else (self.kinds, self.suffix)
        kind, a = kinds[one.kind], [self.of(operand, uniform=uniform) for operand in one.operands]
        real, truth, word = kinds.values()
        out = f"%s{one.number}" if uniform else f"%v{one.number}"
        splat: Callable[[str, str], str] = (lambda kind, text: text) if uniform else self.splat
        if name == "shared":
            pointer = self.new(f"getelementptr double, ptr %c, i64 {one.detail}")
            self.put(f"{out} = load double, ptr {pointer}, align 8")
        elif name == "load":
            self.load(one, out)
        elif name == "entry":
            self.entry(one, out)
        elif name == "index":
            whole = self.new(f"sitofp i64 {self.place(*one.detail)} to double")
            if self.width > 1:
                self.spread(out, "double", whole)
            else:
                self.put(f"{out} = bitcast double {whole} to double")
        elif one.kind == "word" and name in _OF_WORDS:
            self.put(f"{out} = {_OF_WORDS[name]} {word} {a[0]}, {a[1]}")
        elif name in _CONVERTED:
            source, target = (real, word) if one.kind == "word" else (word, real)
            self.put(f"{out} = {_CONVERTED[name]} {source} {a[0]} to {target}")
        elif name in _BINARY:
            self.put(f"{out} = {_BINARY[name]} {truth if name in '&|' else real} {a[0]}, {a[1]}")
        elif name == "not":
            self.put(f"{out} = xor {truth} {a[0]}, {splat('i1', 'true')}")
        elif name == "neg":
            self.put(f"{out} = fneg {real} {a[0]}")
        elif name in _CALLED:
            self.put(f"{out} = {self.call(real, _CALLED[name] + suffix, (real, a[0]))}")
        elif name == "real":
            yes, no = splat("double", "1.0"), splat("double", "0.0")
            self.put(f"{out} = select {truth} {a[0]}, {real} {yes}, {real} {no}")
        elif name == "select":
            self.put(f"{out} = select {truth} {a[0]}, {kind} {a[1]}, {kind} {a[2]}")
        else:
            raise ValueError(f"the operation {name!r} cannot be compiled to machine code")
        if uniform and self.width > 1:
            self.spread(f"%v{one.number}", _KINDS[one.kind], out)

    def place(self, constant: int, terms: Iterable[tuple[int, int]]) -> str:
        """Return the text of the index constant + Σ factor k, k the iteration of a loop, for terms (loop, factor)."""
        text = str(constant)
        for loop, factor in terms:
            product = self.new(f"mul nsw i64 %i{loop}, {factor}")
            text = self.new(f"add nsw i64 {product}, {text}")
        return text

    def memory(self, memory: str, constant: int, terms: Iterable[tuple[int, int]]) -> str:
        """Return the pointer to an entry of `memory`, such as "table0"; its index is as in `place`."""
        key = memory, constant, tuple(sorted(terms))
        for held in reversed(self.places):
            if key in held:
                return str(held[key])
        apart = 1 if memory.startswith("table") else self.width
        at = self.place(apart * constant, [(loop, apart * factor) for loop, factor in key[2]])
        pointer = self.places[-1][key] = self.new(f"getelementptr double, ptr %{memory}, i64 {at}")
        return pointer

    def inside(self, items: Sequence[Any]) -> None:
        """Write the items of a loop or a branch; pointers computed inside are not used afterwards."""
        self.places.append({})
        self.items(items)
        self.places.pop()

    def load(self, one: Symbol, out: str) -> None:
        """Write the load of an entry of an array or of a table, with `out` as the name of the result."""
        pointer, spread = self.memory(*one.detail), one.detail[0].startswith("table") and not one.uniform
        if spread and self.width > 1:
            self.spread(out, "double", self.new(f"load double, ptr {pointer}, align 8"))
        else:
            self.put(f"{out} = load {'double' if one.uniform else self.real}, ptr {pointer}, align 8")

    def store(self, one: Store) -> None:
        """Write the store of a number in an array, for those arms that take all enclosing branches."""
        pointer, value = self.memory(one.memory, one.place.constant, one.place.terms.items()), self.of(one.value)
        if self.masks:
            old = self.new(f"load {self.real}, ptr {pointer}, align 8")
            value = self.new(f"select {self.truth} {self.masks[-1]}, {self.real} {value}, {self.real} {old}")
        self.put(f"store {self.real} {value}, ptr {pointer}, align 8")

    def first_of_row(self, table: Any, of: Any) -> str:
        """Return the LLVM name of the index of the first number of row `of`, or of the nearest row if it is outside."""
        place, last, zero = self.of(of), f"%last{table.number}", self.splat("double", "0.0")
        positive = self.new(f"fcmp ogt {self.real} {place}, {zero}")  # false for nan
        place = self.new(f"select {self.truth} {positive}, {self.real} {place}, {self.real} {zero}")
        inside = self.new(f"fcmp olt {self.real} {place}, {last}")
        place = self.new(f"select {self.truth} {inside}, {self.real} {place}, {self.real} {last}")
        row = self.new(f"fptosi {self.real} {place} to {self.word}")
        return self.new(f"mul nsw {self.word} {row}, {self.splat('i64', str(table.columns))}")

    def entry(self, one: Symbol, out: str) -> None:
        """Write the instructions that load the entry `one` of a row of a table, as the LLVM value named `out`."""
        table, constant, terms = one.detail
        first, column = self.first_of_row(table, one.operands[0]), self.place(constant, terms)
        if self.width > 1:
            self.spread(f"%column{one.number}", "i64", column)
            column = f"%column{one.number}"
        at = self.new(f"add nsw {self.word} {first}, {column}")
        pointers = self.new(f"getelementptr double, ptr %table{table.number}, {self.word} {at}")
        if self.width == 1:
            self.put(f"{out} = load double, ptr {pointers}, align 8")
        else:
            given = (self.pointers, pointers), ("i32", "8"), (self.truth, "splat (i1 true)")
            name = f"masked.gather{self.suffix}.v{self.width}p0"
            self.put(f"{out} = {self.call(self.real, name, *given, (self.real, 'zeroinitializer'))}")

    def rows(self, group: Sequence[Symbol]) -> None:
        """Write the loads of entries of one row of a table."""
        table, _ = group[0].detail
        first = self.first_of_row(table, group[0].operands[0])
        if self.width == 1:
            for one in group:
                row = self.new(f"getelementptr double, ptr %table{table.number}, i64 {first}")
                pointer = self.new(f"getelementptr double, ptr {row}, i64 {one.detail[1]}")
                self.put(f"%v{one.number} = load double, ptr {pointer}, align 8")
            return
        pointers = []
        for lane in range(self.width):
            at = self.new(f"extractelement {self.word} {first}, i64 {lane}")
            pointers.append(self.new(f"getelementptr double, ptr %table{table.number}, i64 {at}"))
        loaded = self.load_rows(pointers, table.columns)
        for one in group:
            self.put(f"%v{one.number} = bitcast {self.real} {loaded[one.detail[1]]} to {self.real}")

    def shuffle(self, size: int, a: str, b: str, mask: Sequence[int]) -> str:
        """Return the vector of the elements of a and b, concatenated, at the indices `mask`."""
        vector, places = f"<{size} x double>", ", ".join(f"i32 {k}" for k in mask)
        return self.new(f"shufflevector {vector} {a}, {vector} {b}, <{len(mask)} x i32> <{places}>")

    def transposed(self, v: Sequence[str]) -> list[str]:
        """Return the columns of the 8 x 8 matrix with the rows `v`, by three rounds of exchanges."""
        for apart, low in _EXCHANGED.items():
            after = list(v)
            for k in (k for k in range(EIGHT) if not k & apart):
                after[k] = self.shuffle(EIGHT, v[k], v[k + apart], low)
                after[k + apart] = self.shuffle(EIGHT, v[k], v[k + apart], [place + apart for place in low])
            v = after
        return list(v)

    def load_rows(self, pointers: Sequence[str], count: int) -> list[str]:
        """Load `count` successive numbers at each arm's pointer; return, for each number, a vector of all arms."""
        found = []
        for first in range(0, count, EIGHT):
            size, lanes = min(EIGHT, count - first), []
            for pointer in pointers:
                at = self.new(f"getelementptr double, ptr {pointer}, i64 {first}")
                one = self.new(f"load <{size} x double>, ptr {at}, align 8")
                filled = [min(k, size - 1) for k in range(EIGHT)]  # entries beyond are not used
                lanes.append(one if size == EIGHT else self.shuffle(size, one, "poison", filled))
            parts = [self.transposed(lanes[k : k + EIGHT])[:size] for k in range(0, self.width, EIGHT)]
            for low, *high in zip(*parts, strict=True):
                found.append(self.shuffle(EIGHT, low, high[0], range(self.width)) if high else low)
        return found

    def items(self, items: Sequence[Any]) -> None:
        """Write the items of a region in order."""
        writers: Any = {Loop: self.loop, Branch: self.branch, For: self.rounds, Store: self.store}
        for source, run in itertools.groupby(items, lambda item: _row_of(item) or id(item)):
            item, *others = run
            if isinstance(source, tuple):
                self.rows([item, *others])
            elif type(item) in writers:
                writers[type(item)](item)
            elif not item.uniform:
                self.operation(item)

    @contextlib.contextmanager
    def counted(self, k: str, count: str) -> Iterator[list[tuple[str, str, str, str]]]:
        """Write a loop over k = 0, ..., count - 1 around the lines of the block; yield a list for the carried numbers.

        For each of these, the block must append (LLVM type, name in the loop, first value, value after an iteration).
        """
        carried: list[tuple[str, str, str, str]] = []
        head, body, out, before = self.block(), self.block(), self.block(), self.here
        self.put(f"br label %{head}")
        self.label(head)
        at = len(self.lines)
        self.lines.append("")
        self.put(f"{k}.on = icmp slt i64 {k}, {count}")
        self.put(f"br i1 {k}.on, label %{body}, label %{out}")
        self.label(body)
        yield carried
        self.put(f"{k}.next = add nsw i64 {k}, 1")
        self.put(f"br label %{head}")
        self.lines[at] = "\n".join(
            f"  {name} = phi {kind} [ {start}, %{before} ], [ {end}, %{self.here} ]"
            for kind, name, start, end in [("i64", k, "0", f"{k}.next"), *carried]
        )
        self.label(out)

    def loop(self, one: Loop) -> None:
        """Write a loop with carried numbers."""
        count = str(one.count)
        if isinstance(one.count, Symbol):
            count = self.new(f"fptosi double %s{one.count.number} to i64")
        with self.counted(f"%k{self.blocks}", count) as carried:
            self.inside(one.region.items)
            for inside, start, end in zip(one.inside, one.start, one.end, strict=True):
                carried.append((self.real, f"%v{inside.number}", self.of(start), self.of(end)))
        for inside, after in zip(one.inside, one.after, strict=True):  # another name for the same number
            self.put(f"%v{after.number} = bitcast {self.real} %v{inside.number} to {self.real}")

    def rounds(self, one: For) -> None:
        """Write a loop that reads and writes arrays."""
        with self.counted(f"%i{one.number}", self.place(one.rounds.constant, one.rounds.terms.items())):
            self.inside(one.region.items)

    def branch(self, one: Branch) -> None:
        """Write a branch, which is taken if the condition holds for at least one arm."""
        then, out, test = self.block(), self.block(), self.of(one.condition)
        if self.width > 1:
            test = self.new(self.call("i1", f"vector.reduce.or.v{self.width}i1", (self.truth, test)))
        before = self.here
        self.put(f"br i1 {test}, label %{then}, label %{out}")
        self.label(then)
        if self.width > 1:
            outer = self.masks[-1] if self.masks else "splat (i1 true)"
            self.masks.append(self.new(f"and {self.truth} {self.of(one.condition)}, {outer}"))
        self.inside(one.region.items)
        if self.width > 1:
            self.masks.pop()
        for first, second, after in zip(one.then, one.otherwise, one.after, strict=True):
            pair = f"{self.real} {self.of(first)}, {self.real} {self.of(second)}"
            self.put(f"%u{after.number} = select {self.truth} {self.of(one.condition)}, {pair}")
        last = self.here
        self.put(f"br label %{out}")
        self.label(out)
        for second, after in zip(one.otherwise, one.after, strict=True):
            pair = f"[ {self.of(second)}, %{before} ], [ %u{after.number}, %{last} ]"
            self.put(f"%v{after.number} = phi {self.real} {pair}")

    def store_rows(self, pointers: Sequence[str], values: Sequence[str]) -> None:
        """Store vectors so that the numbers of each arm lie side by side at its pointer."""
        for first in range(0, len(values), EIGHT):
            numbers = values[first : first + EIGHT]
            for half in range(0, self.width, EIGHT):
                columns = [self.shuffle(self.width, one, "poison", range(half, half + EIGHT)) for one in numbers]
                lanes = self.transposed([*columns, *["poison"] * (EIGHT - len(columns))])
                for pointer, lane in zip(pointers[half:], lanes, strict=False):
                    size, at = len(numbers), self.new(f"getelementptr double, ptr {pointer}, i64 {first}")
                    one = lane if size == EIGHT else self.shuffle(EIGHT, lane, "poison", range(size))
                    self.put(f"store <{size} x double> {one}, ptr {at}, align 8")

    def lane_pointers(self, port: int) -> list[str]:
        """Return, for each arm of the group, the pointer to the arm's numbers of a port."""
        pointers = []
        for lane in range(self.width):
            row = self.new(f"add i64 %g, {lane}")
            at = self.new(f"mul i64 {row}, %stride{port}")
            pointers.append(self.new(f"getelementptr double, ptr %port{port}, i64 {at}"))
        return pointers

    def beginnings(self) -> None:
        """Write the offsets %off0, %off1, ... at which the group's arms begin in the arrays of the ports."""
        for port, (layout, numbers) in enumerate(zip(self.layouts, self.program.ports, strict=True)):
            if layout is PortLayout.BLOCKS:
                block = self.new(f"and i64 %g, {-WIDE}")
                first = self.new(f"mul i64 {block}, {numbers}")
                inner = self.new(f"and i64 %g, {WIDE - 1}")
                self.put(f"%off{port} = add i64 {first}, {inner}")
            elif layout is PortLayout.COLUMNS:
                self.put(f"%off{port} = add i64 %g, 0")
            elif self.width == 1:
                self.put(f"%off{port} = mul i64 %g, %stride{port}")
            else:
                self.spread(f"%apart{port}", "i64", f"%stride{port}")
                self.put(f"%off{port} = mul {self.word} %own, %apart{port}")

    def pointer(self, port: int, k: str) -> str:
        """Return the pointer to number k of a port for the first arm; in `ROWS`, a vector of pointers for all arms."""
        layout, kind = self.layouts[port], "i64"
        apart = {PortLayout.ROWS: "1", PortLayout.BLOCKS: str(WIDE), PortLayout.COLUMNS: f"%stride{port}"}[layout]
        step = self.new(f"mul i64 {k}, {apart}")
        if layout is PortLayout.ROWS and self.width > 1:
            kind, single, step = self.word, step, f"{step}.wide"
            self.spread(step, "i64", single)
        at = self.new(f"add {kind} %off{port}, {step}")
        return self.new(f"getelementptr double, ptr %port{port}, {kind} {at}")

    def masked(self, port: int, of_rows: str, of_columns: str) -> tuple[str, str]:
        """Return the type of a port's pointers, and the LLVM function that loads or stores numbers for some arms only.

        The function is `of_rows` (gather or scatter) for a port in `ROWS`, else `of_columns` (load or store).
        """
        if self.layouts[port] is PortLayout.ROWS:
            return self.pointers, f"masked.{of_rows}{self.suffix}.v{self.width}p0"
        return "ptr", f"masked.{of_columns}{self.suffix}.p0"

    def take(self, port: int, k: Any, _: Any, out: str) -> None:
        """Write the load of number k of a port, for each arm of the group, with `out` as the name of the result."""
        pointer = self.pointer(port, str(k))
        if self.width == 1 or self.layouts[port] is PortLayout.BLOCKS:
            self.put(f"{out} = load {self.real}, ptr {pointer}, align 8")
        else:
            kind, name = self.masked(port, "gather", "load")
            given = (kind, pointer), ("i32", "8"), (self.truth, "%mask"), (self.real, "zeroinitializer")
            self.put(f"{out} = {self.call(self.real, name, *given)}")

    def give(self, port: int, k: Any, _: Any, value: str) -> None:
        """Write the store of `value` in number k of a port, for each arm of the group."""
        pointer = self.pointer(port, str(k))
        if self.width == 1 or self.layouts[port] is PortLayout.BLOCKS:
            self.put(f"store {self.real} {value}, ptr {pointer}, align 8")
        else:
            kind, name = self.masked(port, "scatter", "store")
            given = (self.real, value), (kind, pointer), ("i32", "8"), (self.truth, "%mask")
            self.put(self.call("void", name, *given))

    def exchange(
        self, numbers: Sequence[_Number], one: Callable[..., None], rows: Callable[[Sequence[_Number]], None]
    ) -> None:
        """Load or store each number by `one`; if the group has several arms, all those of `ROWS` at once by `rows`."""
        in_rows = [self.width > 1 and self.layouts[port] is PortLayout.ROWS for port, *_ in numbers]
        for number, is_in_rows in zip(numbers, in_rows, strict=True):
            if not is_in_rows:
                one(*number)
        if any(in_rows):
            rows(list(itertools.compress(numbers, in_rows)))

    def if_full(self, few: Callable[[], None], whole: Callable[[], None]) -> tuple[str, str]:
        """Write the code `few` for an incomplete group and `whole` for a whole group; return their blocks' names."""
        blocks = self.block(), self.block()
        out = self.block()
        self.put(f"br i1 %full, label %{blocks[1]}, label %{blocks[0]}")
        for block, write in zip(blocks, (few, whole), strict=True):
            self.label(block)
            write()
            self.put(f"br label %{out}")
        self.label(out)
        return blocks

    def take_rows(self, wanted: Sequence[_Number]) -> None:
        """Write the loads of `wanted`, numbers of ports in `ROWS`: whole rows if the group is full, else one by one."""
        found = {}

        def one_by_one() -> None:
            for port, k, place, name in wanted:
                self.take(port, k, place, f"{name}.few")

        def by_rows() -> None:
            for port in dict.fromkeys(port for port, *_ in wanted):
                for k, name in enumerate(self.load_rows(self.lane_pointers(port), self.program.ports[port])):
                    found[port, k] = name

        few, whole = self.if_full(one_by_one, by_rows)
        for port, k, _, name in wanted:
            self.put(f"{name} = phi {self.real} [ {name}.few, %{few} ], [ {found[port, k]}, %{whole} ]")

    def give_rows(self, given: Sequence[_Number]) -> None:
        """Write the stores of `given`, numbers of ports in `ROWS`.

        If the group is full, rows that change as a whole are stored as such, other numbers one by one.
        """

        def one_by_one() -> None:
            for number in given:
                self.give(*number)

        def by_rows() -> None:
            for port, run in itertools.groupby(given, lambda number: number[0]):
                own = list(run)
                if len(own) == self.program.ports[port]:
                    self.store_rows(self.lane_pointers(port), [value for *_, value in own])
                else:
                    for number in own:
                        self.give(*number)

        self.if_full(one_by_one, by_rows)

    def runs(self) -> list[tuple[int, int, int, int]]:
        """Return (port, index in the port, index among all numbers, length) for each run of numbers that are in arrays.

        Both indices are those of the first number of the run.
        """
        found, place = list[tuple[int, int, int, int]](), 0
        for port, count in enumerate(self.program.ports):
            for inside, numbers in itertools.groupby(range(place, place + count), self.program.cells.__contains__):
                first, *others = numbers
                if inside:
                    found.append((port, first - place, first, 1 + len(others)))
            place += count
        return found

    def copy(self, port: int, first: int, place: int, count: int, *, back: bool) -> None:
        """Copy `count` numbers of a port, from `first` on, to `place` in the group's memory; if `back`, vice versa."""
        with self.counted(k := f"%k{self.blocks}", str(count)):
            own = self.room(self.new(f"add i64 {k}, {place}"))
            number = self.new(f"add i64 {k}, {first}")
            if back:
                self.give(port, number, None, self.new(f"load {self.real}, ptr {own}, align 8"))
            else:
                self.take(port, number, None, f"{k}.held")
                self.put(f"store {self.real} {k}.held, ptr {own}, align 8")

    def room(self, place: Any) -> str:
        """Return the name of a pointer to the memory for number `place`, its index among the numbers of all ports."""
        return self.new(f"getelementptr double, ptr %room, i64 {self.new(f'mul i64 {place}, {self.width}')}")

    def whole_text(self) -> str:
        """Return the LLVM text of the whole program."""
        p, width = self.program, self.width
        numbers = [(port, k) for port, count in enumerate(p.ports) for k in range(count)]
        places, needed = [place for place in range(len(numbers)) if place not in p.cells], self._needed()
        names = [f"%in{place}" if self.repeated else f"%v{own.number}" for place, own in enumerate(p.inputs)]
        taken = [(*numbers[place], place, names[place]) for place in places if id(p.inputs[place]) in needed]
        changed = [(*numbers[place], place) for place in places if p.outputs[place] is not p.inputs[place]]
        self.label("entry")
        if self.repeated:
            self.put(f"%room = alloca double, i64 {max(1, len(p.inputs)) * width}, align 64")
        for k, size in enumerate(p.arrays):
            self.put(f"%array{k} = alloca double, i64 {max(1, size) * width}, align 64")
        held = [*(f"port{k}" for k in range(len(p.ports))), "c", *(f"table{k}" for k in range(len(p.tables)))]
        apart = [name.replace("port", "stride").replace("table", "rows") for name in held if name != "c"]
        for k, name in enumerate(["first", "stop", "steps", *held, *apart]):
            pointer = self.new(f"getelementptr i64, ptr %job, i64 {k}")
            self.put(f"%{name} = load {'ptr' if name in held else 'i64'}, ptr {pointer}, align 8")
        for k in range(len(p.tables)):
            row = self.new(f"sub i64 %rows{k}, 1")
            if width > 1:
                self.spread(f"%last{k}", "double", self.new(f"sitofp i64 {row} to double"))
            else:
                self.put(f"%last{k} = sitofp i64 {row} to double")
        for one in (*p.constants, *p.top.items):
            if isinstance(one, Symbol) and one.uniform:
                self.operation(one)
        self.put("br label %groups")
        self.label("groups")
        self.put("%g = phi i64 [ %first, %entry ], [ %g1, %next ]")
        self.put("%more = icmp slt i64 %g, %stop")
        self.put("br i1 %more, label %group, label %done")
        self.label("group")
        if width > 1:
            iota = ", ".join(f"i64 {k}" for k in range(width))
            self.spread("%gs", "i64", "%g")
            self.spread("%stops", "i64", "%stop")
            self.put(f"%own = add {self.word} %gs, <{iota}>")
            self.put(f"%mask = icmp slt {self.word} %own, %stops")
            self.put(f"%after = add i64 %g, {width}")
            self.put("%full = icmp sle i64 %after, %stop")
        self.beginnings()
        for run in self.runs():
            self.copy(*run, back=False)
        self.exchange(taken, self.take, self.take_rows)
        if self.repeated:
            self.several_times(taken, changed)
        else:
            self.items(p.top.items)
        given = []
        for port, k, place in changed:
            value = self.of(p.outputs[place])
            if self.repeated:
                value = self.new(f"load {self.real}, ptr {self.room(place)}, align 8")
            given.append((port, k, place, value))
        self.exchange(given, self.give, self.give_rows)
        for run in self.runs():
            self.copy(*run, back=True)
        self.put("br label %next")
        self.label("next")
        self.put(f"%g1 = add i64 %g, {width}")
        self.put("br label %groups")
        self.label("done")
        self.put("ret void")
        head = "define void @kernel(ptr noalias readonly %job) #0 {"
        tail = 'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }'
        return "\n".join([*sorted(self.declared), head, *self.lines, "}", tail, ""])

    def several_times(self, taken: Sequence[_Number], changed: Sequence[tuple[int, int, int]]) -> None:
        """Write a loop over time steps, between which inputs `taken` and outputs `changed` stay in the group's memory.

        `changed` contains (port, index in the port, index among all numbers).
        """
        for _, _, place, name in taken:
            self.put(f"store {self.real} {name}, ptr {self.room(place)}, align 8")
        before, at = self.here, len(self.lines) + 2
        self.put("br label %time")
        self.label("time")
        self.lines.append("")
        for _, _, place, _ in taken:
            room, name = self.room(place), f"%v{self.program.inputs[place].number}"
            self.put(f"{name} = load {self.real}, ptr {room}, align 8")
        self.items(self.program.top.items)
        for _, _, place in changed:
            value = self.of(self.program.outputs[place])
            self.put(f"store {self.real} {value}, ptr {self.room(place)}, align 8")
        self.put("%t1 = add i64 %t, 1")
        self.put("%again = icmp slt i64 %t1, %steps")
        self.put("br i1 %again, label %time, label %back")
        self.lines[at] = f"  %t = phi i64 [ 0, %{before} ], [ %t1, %{self.here} ]"
        self.label("back")

    def _needed(self) -> set[int]:
        """Return the ids of all numbers that an operation, a loop, a branch, a store or a changed output uses."""
        pairs = zip(self.program.outputs, self.program.inputs, strict=True)
        needed = {id(out) for out, own in pairs if out is not own}
        regions = [self.program.top]
        for region in regions:
            for item in region.items:
                for part in item.operands if isinstance(item, Symbol) else item:  # of a loop, a branch or a store
                    if isinstance(part, Region):
                        regions.append(part)
                    else:
                        needed.update(map(id, part if isinstance(part, list) else [part]))
        return needed


def kernel_text(program: Program, layouts: Sequence[PortLayout], width: int, *, repeated: bool = True) -> str:
    """Return a program as LLVM text for `width` arms at once; if `repeated`, with a loop over time steps."""
    return _Writer(program, layouts, width, repeated=repeated).whole_text()
