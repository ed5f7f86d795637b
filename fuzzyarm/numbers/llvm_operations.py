"""A recorded program's operations, loops and branches as LLVM's text, for one arm or for vectors of arms.

No operation may be contracted or reordered: there are no flags that would allow it.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.regions import Branch, For, Loop, Store
from fuzzyarm.numbers.symbols import Symbol, Word

__all__ = ["CALLED", "EIGHT", "Operations"]

_COMPARED = {"<": "olt", "<=": "ole", ">": "ogt", ">=": "oge", "==": "oeq", "!=": "une"}
EIGHT = 8  # numbers that are exchanged between vectors together
_EXCHANGED = {1: (0, 8, 2, 10, 4, 12, 6, 14), 2: (0, 1, 8, 9, 4, 5, 12, 13), 4: (0, 1, 2, 3, 8, 9, 10, 11)}
_ARITHMETIC = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
CALLED = {"abs": "fabs", "rint": "rint", "floor": "floor", "sqrt": "sqrt", "log": "log"}
"""LLVM's functions, by operation."""

_OF_WORDS = {"+": "add", "*": "mul", "xor": "xor", "shift": "lshr"}
_CONVERTED = {"word": "bitcast", "whole": "fptosi", "number": "sitofp", "bits": "bitcast"}
_KINDS = {"real": "double", "truth": "i1", "word": "i64"}


def _row_of(item: Any) -> Any:
    """Return what rows are looked up by, if the item is a number of a row: its place and its table."""
    if isinstance(item, Symbol) and item.operation == "row":
        return item.operands[0] if isinstance(item.operands[0], float) else id(item.operands[0]), item.detail[0]
    return None


def _literal(number: Any) -> str:
    return f"0x{struct.unpack('>Q', struct.pack('>d', float(number)))[0]:016X}"


class Operations:
    """Writes operations of a program; each method puts lines, or returns the name of what they compute."""

    def __init__(self, program: Program, width: int) -> None:
        """Begin with no line."""
        self.program, self.width = program, width
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
        """Add a line."""
        self.lines.append("  " + line)

    def label(self, name: str) -> None:
        """Begin a block."""
        self.lines.append(f"{name}:")
        self.here = name

    def block(self) -> str:
        """Return a new name of a block."""
        self.blocks += 1
        return f"block{self.blocks}"

    def splat(self, kind: str, text: str) -> str:
        """Return a constant, once for each arm."""
        return f"splat ({kind} {text})" if self.width > 1 else text

    def spread(self, name: str, kind: str, one: str) -> None:
        """Put one number into each place of a vector."""
        vector = f"<{self.width} x {kind}>"
        self.put(f"%one.{name} = insertelement {vector} poison, {kind} {one}, i64 0")
        zeros = f"<{self.width} x i32> zeroinitializer"
        self.put(f"%{name} = shufflevector {vector} %one.{name}, {vector} poison, {zeros}")

    def of(self, operand: Any, *, uniform: bool = False) -> str:
        """Return the text of an operand, as one number or as one for each arm."""
        if isinstance(operand, Symbol):
            return f"%s{operand.number}" if operand.uniform and (uniform or self.width == 1) else f"%v{operand.number}"
        kind, text = ("i64", str(operand % 2**64)) if isinstance(operand, Word) else ("double", _literal(operand))
        return text if uniform else self.splat(kind, text)

    def operation(self, one: Symbol) -> None:
        """Write an operation."""
        uniform, name = one.uniform, one.operation
        kinds, suffix = (_KINDS, ".f64") if uniform else (self.kinds, self.suffix)
        kind, a = kinds[one.kind], [self.of(operand, uniform=uniform) for operand in one.operands]
        real, truth, word = kinds.values()
        out = f"%s{one.number}" if uniform else f"%v{one.number}"
        splat: Callable[[str, str], str] = (lambda kind, text: text) if uniform else self.splat
        if name == "shared":
            self.put(f"%p{one.number} = getelementptr double, ptr %c, i64 {one.detail}")
            self.put(f"{out} = load double, ptr %p{one.number}, align 8")
        elif name == "load":
            self.load(one, out)
        elif name == "entry":
            self.entry(one, out)
        elif name == "index":
            whole = self.fresh()
            self.put(f"{whole} = sitofp i64 {self.place(*one.detail)} to double")
            if self.width > 1:
                self.spread(out[1:], "double", whole)
            else:
                self.put(f"{out} = bitcast double {whole} to double")
        elif one.kind == "word" and name in _OF_WORDS:
            self.put(f"{out} = {_OF_WORDS[name]} {word} {a[0]}, {a[1]}")
        elif name in _CONVERTED:
            source, target = (real, word) if one.kind == "word" else (word, real)
            self.put(f"{out} = {_CONVERTED[name]} {source} {a[0]} to {target}")
        elif name in _ARITHMETIC:
            self.put(f"{out} = {_ARITHMETIC[name]} {real} {a[0]}, {a[1]}")
        elif name in _COMPARED:
            self.put(f"{out} = fcmp {_COMPARED[name]} {real} {a[0]}, {a[1]}")
        elif name in ("&", "|"):
            self.put(f"{out} = {'and' if name == '&' else 'or'} {truth} {a[0]}, {a[1]}")
        elif name == "not":
            self.put(f"{out} = xor {truth} {a[0]}, {splat('i1', 'true')}")
        elif name == "neg":
            self.put(f"{out} = fneg {real} {a[0]}")
        elif name in CALLED:
            self.declared.add(f"declare {real} @llvm.{CALLED[name]}{suffix}({real})")
            self.put(f"{out} = call {real} @llvm.{CALLED[name]}{suffix}({real} {a[0]})")
        elif name == "real":
            yes, no = splat("double", "1.0"), splat("double", "0.0")
            self.put(f"{out} = select {truth} {a[0]}, {real} {yes}, {real} {no}")
        elif name == "select":
            self.put(f"{out} = select {truth} {a[0]}, {kind} {a[1]}, {kind} {a[2]}")
        else:
            raise ValueError(f"operation {name} has no machine code")
        if uniform and self.width > 1:
            self.spread(f"v{one.number}", _KINDS[one.kind], out)

    def place(self, constant: int, terms: Iterable[tuple[int, int]]) -> str:
        """Return the text of an index."""
        text = str(constant)
        for loop, factor in terms:
            product, total = self.fresh(), self.fresh()
            self.put(f"{product} = mul nsw i64 %i{loop}, {factor}")
            self.put(f"{total} = add nsw i64 {product}, {text}")
            text = total
        return text

    def memory(self, memory: str, constant: int, terms: Iterable[tuple[int, int]]) -> str:
        """Return the pointer to a number of an array, or to those of the group's arms."""
        key = memory, constant, tuple(sorted(terms))
        for held in reversed(self.places):
            if key in held:
                return str(held[key])
        apart, pointer = 1 if memory.startswith("table") else self.width, self.fresh()
        at = self.place(apart * constant, [(loop, apart * factor) for loop, factor in key[2]])
        self.put(f"{pointer} = getelementptr double, ptr %{memory}, i64 {at}")
        self.places[-1][key] = pointer
        return pointer

    def inside(self, items: Sequence[Any]) -> None:
        """Write what a loop or a branch holds; what it finds out about places is not known behind it."""
        self.places.append({})
        self.items(items)
        self.places.pop()

    def load(self, one: Symbol, out: str) -> None:
        """Load a number of an array or of a table."""
        pointer, spread = self.memory(*one.detail), one.detail[0].startswith("table") and not one.uniform
        if spread and self.width > 1:
            single = self.fresh()
            self.put(f"{single} = load double, ptr {pointer}, align 8")
            self.spread(out[1:], "double", single)
        else:
            self.put(f"{out} = load {'double' if one.uniform else self.real}, ptr {pointer}, align 8")

    def store(self, one: Store) -> None:
        """Store a number in an array, where the branches around hold."""
        pointer, value = self.memory(one.memory, one.place.constant, one.place.terms.items()), self.of(one.value)
        if self.masks:
            old, new = self.fresh(), self.fresh()
            self.put(f"{old} = load {self.real}, ptr {pointer}, align 8")
            self.put(f"{new} = select {self.truth} {self.masks[-1]}, {self.real} {value}, {self.real} {old}")
            value = new
        self.put(f"store {self.real} {value}, ptr {pointer}, align 8")

    def first_of_row(self, n: int, table: Any, of: Any) -> str:
        """Return where a row begins in its table, whatever is asked for."""
        place, last, zero = self.of(of), f"%last{table.number}", self.splat("double", "0.0")
        self.put(f"%a{n} = fcmp ogt {self.real} {place}, {zero}")  # not for nan
        self.put(f"%b{n} = select {self.truth} %a{n}, {self.real} {place}, {self.real} {zero}")
        self.put(f"%d{n} = fcmp olt {self.real} %b{n}, {last}")
        self.put(f"%e{n} = select {self.truth} %d{n}, {self.real} %b{n}, {self.real} {last}")
        self.put(f"%x{n} = fptosi {self.real} %e{n} to {self.word}")
        self.put(f"%y{n} = mul nsw {self.word} %x{n}, {self.splat('i64', str(table.columns))}")
        return f"%y{n}"

    def entry(self, one: Symbol, out: str) -> None:
        """Look up a number of a row in a column that may be the index of a loop."""
        (table, constant, terms), n = one.detail, one.number
        first, column = self.first_of_row(n, table, one.operands[0]), self.place(constant, terms)
        if self.width > 1:
            self.spread(f"f{n}", "i64", column)
            column = f"%f{n}"
        self.put(f"%z{n} = add nsw {self.word} {first}, {column}")
        pointers = "ptr" if self.width == 1 else self.pointers
        self.put(f"%p{n} = getelementptr double, ptr %table{table.number}, {self.word} %z{n}")
        if self.width == 1:
            self.put(f"{out} = load double, {pointers} %p{n}, align 8")
        else:
            self.gather(out, f"%p{n}", "splat (i1 true)")

    def rows(self, group: Sequence[Symbol]) -> None:
        """Look up numbers of a row, whose place is within the table whatever is asked for."""
        table, _ = group[0].detail
        n = group[0].number
        first = self.first_of_row(n, table, group[0].operands[0])
        if self.width == 1:
            for one in group:
                self.put(f"%p{one.number} = getelementptr double, ptr %table{table.number}, i64 {first}")
                self.put(f"%q{one.number} = getelementptr double, ptr %p{one.number}, i64 {one.detail[1]}")
                self.put(f"%v{one.number} = load double, ptr %q{one.number}, align 8")
            return
        pointers = []
        for lane in range(self.width):
            self.put(f"%l{n}.{lane} = extractelement {self.word} {first}, i64 {lane}")
            self.put(f"%r{n}.{lane} = getelementptr double, ptr %table{table.number}, i64 %l{n}.{lane}")
            pointers.append(f"%r{n}.{lane}")
        loaded = self.load_rows(pointers, table.columns)
        for one in group:
            self.put(f"%v{one.number} = bitcast {self.real} {loaded[one.detail[1]]} to {self.real}")

    def fresh(self) -> str:
        """Return a new name."""
        self.names += 1
        return f"%w{self.names}"

    def shuffle(self, size: int, a: str, b: str, mask: Sequence[int]) -> str:
        """Return the numbers of two vectors at some places."""
        out, places = self.fresh(), ", ".join(f"i32 {k}" for k in mask)
        vector = f"<{size} x double>"
        self.put(f"{out} = shufflevector {vector} {a}, {vector} {b}, <{len(mask)} x i32> <{places}>")
        return out

    def transposed(self, v: Sequence[str]) -> list[str]:
        """Return the eight columns of eight rows of eight numbers, in three rounds of exchanges."""
        for apart, low in _EXCHANGED.items():
            after = list(v)
            for k in (k for k in range(EIGHT) if not k & apart):
                after[k] = self.shuffle(EIGHT, v[k], v[k + apart], low)
                after[k + apart] = self.shuffle(EIGHT, v[k], v[k + apart], [place + apart for place in low])
            v = after
        return list(v)

    def load_rows(self, pointers: Sequence[str], count: int) -> list[str]:
        """Return vectors of the first `count` numbers that lie at the pointer of each arm."""
        found = []
        for first in range(0, count, EIGHT):
            size, lanes = min(EIGHT, count - first), []
            for pointer in pointers:
                at, one = self.fresh(), self.fresh()
                self.put(f"{at} = getelementptr double, ptr {pointer}, i64 {first}")
                self.put(f"{one} = load <{size} x double>, ptr {at}, align 8")
                filled = [min(k, size - 1) for k in range(EIGHT)]  # what is beyond is not used
                lanes.append(one if size == EIGHT else self.shuffle(size, one, "poison", filled))
            parts = [self.transposed(lanes[k : k + EIGHT])[:size] for k in range(0, self.width, EIGHT)]
            for low, *high in zip(*parts, strict=True):
                found.append(self.shuffle(EIGHT, low, high[0], range(self.width)) if high else low)
        return found

    def gather(self, out: str, places: str, mask: str) -> None:
        """Load a number of each arm from its own place."""
        name = f"@llvm.masked.gather{self.suffix}.v{self.width}p0"
        self.declared.add(f"declare {self.real} {name}({self.pointers}, i32, {self.truth}, {self.real})")
        rest = f"i32 8, {self.truth} {mask}, {self.real} zeroinitializer"
        self.put(f"{out} = call {self.real} {name}({self.pointers} {places}, {rest})")

    def scatter(self, value: str, places: str) -> None:
        """Store a number of each arm at its own place."""
        name = f"@llvm.masked.scatter{self.suffix}.v{self.width}p0"
        self.declared.add(f"declare void {name}({self.real}, {self.pointers}, i32, {self.truth})")
        self.put(f"call void {name}({self.real} {value}, {self.pointers} {places}, i32 8, {self.truth} %mask)")

    def items(self, items: Sequence[Any]) -> None:
        """Write what a region holds, in order."""
        for source, run in itertools.groupby(items, lambda item: _row_of(item) or id(item)):
            item, *others = run
            if isinstance(source, tuple):
                self.rows([item, *others])
            elif isinstance(item, Loop):
                self.loop(item)
            elif isinstance(item, Branch):
                self.branch(item)
            elif isinstance(item, For):
                self.rounds(item)
            elif isinstance(item, Store):
                self.store(item)
            elif not item.uniform:
                self.operation(item)

    def loop(self, one: Loop) -> None:
        """Write a loop with carried numbers."""
        head, body, out, before = self.block(), self.block(), self.block(), self.here
        count = str(one.count)
        if isinstance(one.count, Symbol):
            self.put(f"%n{head} = fptosi double %s{one.count.number} to i64")
            count = f"%n{head}"
        self.put(f"br label %{head}")
        self.label(head)
        at = len(self.lines)
        self.lines.append("")
        self.put(f"%t{head} = icmp slt i64 %k{head}, {count}")
        self.put(f"br i1 %t{head}, label %{body}, label %{out}")
        self.label(body)
        self.inside(one.region.items)
        self.put(f"%m{head} = add i64 %k{head}, 1")
        self.put(f"br label %{head}")
        phis = [f"  %k{head} = phi i64 [ 0, %{before} ], [ %m{head}, %{self.here} ]"]
        for inside, start, end in zip(one.inside, one.start, one.end, strict=True):
            pairs = f"[ {self.of(start)}, %{before} ], [ {self.of(end)}, %{self.here} ]"
            phis.append(f"  %v{inside.number} = phi {self.real} {pairs}")
        self.lines[at] = "\n".join(phis)
        self.label(out)
        for inside, after in zip(one.inside, one.after, strict=True):  # another name for the same number
            self.put(f"%v{after.number} = bitcast {self.real} %v{inside.number} to {self.real}")

    def rounds(self, one: For) -> None:
        """Write a loop over arrays."""
        head, body, out, before = self.block(), self.block(), self.block(), self.here
        count, i = self.place(one.rounds.constant, one.rounds.terms.items()), f"%i{one.number}"
        self.put(f"br label %{head}")
        self.label(head)
        at = len(self.lines)
        self.lines.append("")
        self.put(f"{i}.on = icmp slt i64 {i}, {count}")
        self.put(f"br i1 {i}.on, label %{body}, label %{out}")
        self.label(body)
        self.inside(one.region.items)
        self.put(f"{i}.next = add nsw i64 {i}, 1")
        self.put(f"br label %{head}")
        self.lines[at] = f"  {i} = phi i64 [ 0, %{before} ], [ {i}.next, %{self.here} ]"
        self.label(out)

    def branch(self, one: Branch) -> None:
        """Write a branch, which is taken if the condition holds for one of the arms."""
        then, out, test = self.block(), self.block(), self.of(one.condition)
        if self.width > 1:
            name = f"@llvm.vector.reduce.or.v{self.width}i1"
            self.declared.add(f"declare i1 {name}({self.truth})")
            self.put(f"%t{then} = call i1 {name}({self.truth} {test})")
            test = f"%t{then}"
        before = self.here
        self.put(f"br i1 {test}, label %{then}, label %{out}")
        self.label(then)
        if self.width > 1:
            mask = self.fresh()
            outer = self.masks[-1] if self.masks else "splat (i1 true)"
            self.put(f"{mask} = and {self.truth} {self.of(one.condition)}, {outer}")
            self.masks.append(mask)
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
