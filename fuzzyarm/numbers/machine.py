"""A recorded program as machine code, by LLVM: the same for one arm and for many at once, with the same bits.

The program becomes LLVM's text with vectors of `width` arms, and no operation may be contracted or reordered. Numbers
of arms stay where they are, see `Layout`. A group of `width` arms is taken from there, stays in the processor's first
cache for all its steps, and is put back.

Machine code is kept on disk by a digest of text, processor, level and LLVM's version. A file that is not what was
written is made again, and without a folder to write there are no files.
"""

from __future__ import annotations

import contextlib
import ctypes
import enum
import functools
import hashlib
import itertools
import os
import struct
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np

from fuzzyarm.common.files import write_atomically
from fuzzyarm.numbers.symbols import Branch, For, Loop, Program, Store, Symbol, Word

__all__ = ["CACHE", "WIDE", "Call", "Kernel", "Layout", "kernel_text"]

WIDE = 16
"""Arms at once where there are many."""

CACHE = "FUZZYARM_CACHE"
"""Environment variable with the folder for machine code; by default that of the user's caches."""


class Layout(enum.Enum):
    """How the numbers of a port lie in its array.

    `ROWS`: (arms, numbers), the numbers of an arm side by side, rows may lie apart. `COLUMNS`: (numbers, arms), the
    arms side by side. `BLOCKS`: (blocks, numbers, `WIDE`), `WIDE` arms in each block; there may be room for more arms
    in the last one, which is written to, too.
    """

    ROWS = enum.auto()
    COLUMNS = enum.auto()
    BLOCKS = enum.auto()


_COMPARED = {"<": "olt", "<=": "ole", ">": "ogt", ">=": "oge", "==": "oeq", "!=": "une"}
_EIGHT = 8  # numbers that are exchanged between vectors together
_EXCHANGED = {1: (0, 8, 2, 10, 4, 12, 6, 14), 2: (0, 1, 8, 9, 4, 5, 12, 13), 4: (0, 1, 2, 3, 8, 9, 10, 11)}
_ARITHMETIC = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
_CALLED = {"abs": "fabs", "rint": "rint", "floor": "floor", "sqrt": "sqrt", "log": "log"}
_OF_WORDS = {"+": "add", "*": "mul", "xor": "xor", "shift": "lshr"}
_CONVERTED = {"word": "bitcast", "whole": "fptosi", "number": "sitofp", "bits": "bitcast"}
_KINDS = {"real": "double", "truth": "i1", "word": "i64"}
_LEVELS = {1: 2, WIDE: 1}  # of LLVM's optimisation, by width


def _row_of(item: Any) -> Any:
    """Return what rows are looked up by, if the item is a number of a row: its place and its table."""
    if isinstance(item, Symbol) and item.operation == "row":
        return item.operands[0] if isinstance(item.operands[0], float) else id(item.operands[0]), item.detail[0]
    return None


def _literal(number: Any) -> str:
    return f"0x{struct.unpack('>Q', struct.pack('>d', float(number)))[0]:016X}"


class _Writer:
    """Writes a program as LLVM's text."""

    def __init__(self, program: Program, layouts: Sequence[Layout], width: int, *, repeated: bool) -> None:
        self.program, self.layouts, self.width = program, layouts, width
        self.repeated = repeated or bool(program.cells)  # numbers of ports lie in an array of the group's own
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
        self.lines.append("  " + line)

    def label(self, name: str) -> None:
        self.lines.append(f"{name}:")
        self.here = name

    def block(self) -> str:
        self.blocks += 1
        return f"block{self.blocks}"

    def splat(self, kind: str, text: str) -> str:
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
        elif name in _CALLED:
            self.declared.add(f"declare {real} @llvm.{_CALLED[name]}{suffix}({real})")
            self.put(f"{out} = call {real} @llvm.{_CALLED[name]}{suffix}({real} {a[0]})")
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
        pointer, spread = self.memory(*one.detail), one.detail[0].startswith("table") and not one.uniform
        if spread and self.width > 1:
            single = self.fresh()
            self.put(f"{single} = load double, ptr {pointer}, align 8")
            self.spread(out[1:], "double", single)
        else:
            self.put(f"{out} = load {'double' if one.uniform else self.real}, ptr {pointer}, align 8")

    def store(self, one: Store) -> None:
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
        self.names += 1
        return f"%w{self.names}"

    def shuffle(self, size: int, a: str, b: str, mask: Sequence[int]) -> str:
        out, places = self.fresh(), ", ".join(f"i32 {k}" for k in mask)
        vector = f"<{size} x double>"
        self.put(f"{out} = shufflevector {vector} {a}, {vector} {b}, <{len(mask)} x i32> <{places}>")
        return out

    def transposed(self, v: Sequence[str]) -> list[str]:
        """Return the eight columns of eight rows of eight numbers, in three rounds of exchanges."""
        for apart, low in _EXCHANGED.items():
            after = list(v)
            for k in (k for k in range(_EIGHT) if not k & apart):
                after[k] = self.shuffle(_EIGHT, v[k], v[k + apart], low)
                after[k + apart] = self.shuffle(_EIGHT, v[k], v[k + apart], [place + apart for place in low])
            v = after
        return list(v)

    def load_rows(self, pointers: Sequence[str], count: int) -> list[str]:
        """Return vectors of the first `count` numbers that lie at the pointer of each arm."""
        found = []
        for first in range(0, count, _EIGHT):
            size, lanes = min(_EIGHT, count - first), []
            for pointer in pointers:
                at, one = self.fresh(), self.fresh()
                self.put(f"{at} = getelementptr double, ptr {pointer}, i64 {first}")
                self.put(f"{one} = load <{size} x double>, ptr {at}, align 8")
                filled = [min(k, size - 1) for k in range(_EIGHT)]  # what is beyond is not used
                lanes.append(one if size == _EIGHT else self.shuffle(size, one, "poison", filled))
            parts = [self.transposed(lanes[k : k + _EIGHT]) for k in range(0, self.width, _EIGHT)]
            found += [self.shuffle(_EIGHT, low, high, range(WIDE)) for low, high in zip(*parts, strict=True)][:size]
        return found

    def store_rows(self, pointers: Sequence[str], values: Sequence[str]) -> None:
        """Store vectors so that the numbers of each arm lie side by side at its pointer."""
        for first in range(0, len(values), _EIGHT):
            numbers = values[first : first + _EIGHT]
            for half in range(0, self.width, _EIGHT):
                columns = [self.shuffle(WIDE, one, "poison", range(half, half + _EIGHT)) for one in numbers]
                lanes = self.transposed([*columns, *["poison"] * (_EIGHT - len(columns))])
                for pointer, lane in zip(pointers[half:], lanes, strict=False):
                    at, size = self.fresh(), len(numbers)
                    self.put(f"{at} = getelementptr double, ptr {pointer}, i64 {first}")
                    one = lane if size == _EIGHT else self.shuffle(_EIGHT, lane, "poison", range(size))
                    self.put(f"store <{size} x double> {one}, ptr {at}, align 8")

    def lane_pointers(self, port: int) -> list[str]:
        """Return the pointers to the numbers of a port of each of the group's arms."""
        pointers = []
        for lane in range(self.width):
            row, at, pointer = self.fresh(), self.fresh(), self.fresh()
            self.put(f"{row} = add i64 %g, {lane}")
            self.put(f"{at} = mul i64 {row}, %stride{port}")
            self.put(f"{pointer} = getelementptr double, ptr %port{port}, i64 {at}")
            pointers.append(pointer)
        return pointers

    def gather(self, out: str, places: str, mask: str) -> None:
        name = f"@llvm.masked.gather{self.suffix}.v{self.width}p0"
        self.declared.add(f"declare {self.real} {name}({self.pointers}, i32, {self.truth}, {self.real})")
        rest = f"i32 8, {self.truth} {mask}, {self.real} zeroinitializer"
        self.put(f"{out} = call {self.real} {name}({self.pointers} {places}, {rest})")

    def scatter(self, value: str, places: str) -> None:
        name = f"@llvm.masked.scatter{self.suffix}.v{self.width}p0"
        self.declared.add(f"declare void {name}({self.real}, {self.pointers}, i32, {self.truth})")
        self.put(f"call void {name}({self.real} {value}, {self.pointers} {places}, i32 8, {self.truth} %mask)")

    def items(self, items: Sequence[Any]) -> None:
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

    def beginnings(self) -> None:
        """Say where the group's arms begin in each port, %off, and how far their numbers lie apart, %step."""
        for port, (layout, numbers) in enumerate(zip(self.layouts, self.program.ports, strict=True)):
            if layout is Layout.BLOCKS:
                self.put(f"%base{port} = and i64 %g, {-WIDE}")
                self.put(f"%of{port} = mul i64 %base{port}, {numbers}")
                self.put(f"%inner{port} = and i64 %g, {WIDE - 1}")
                self.put(f"%off{port} = add i64 %of{port}, %inner{port}")
            elif layout is Layout.COLUMNS:
                self.put(f"%off{port} = add i64 %g, 0")
            elif self.width == 1:
                self.put(f"%off{port} = mul i64 %g, %stride{port}")
            else:
                self.spread(f"apart{port}", "i64", f"%stride{port}")
                self.put(f"%off{port} = mul {self.word} %own, %apart{port}")

    def pointer(self, port: int, k: int, name: str) -> str:
        """Return the pointer to number k of the group's first arm, or those of all of them in rows."""
        layout, whole, step = self.layouts[port], "i64", str(k)
        if layout is Layout.ROWS:
            whole, step = self.word, self.splat("i64", step)
        elif layout is Layout.BLOCKS:
            step = str(WIDE * k)
        else:
            self.put(f"%{name}.step = mul i64 %stride{port}, {k}")
            step = f"%{name}.step"
        self.put(f"%{name}.at = add {whole} %off{port}, {step}")
        self.put(f"%{name}.pointer = getelementptr double, ptr %port{port}, {whole} %{name}.at")
        return f"%{name}.pointer"

    def take(self, out: str, port: int, k: int, place: int) -> None:
        """Load number k of a port."""
        self.take_at(out, self.pointer(port, k, f"take{place}"), self.layouts[port])

    def take_at(self, out: str, pointer: str, layout: Layout) -> None:
        if self.width == 1 or layout is Layout.BLOCKS:
            self.put(f"{out} = load {self.real}, ptr {pointer}, align 8")
        elif layout is Layout.ROWS:
            self.gather(out, pointer, "%mask")
        else:
            name = f"@llvm.masked.load{self.suffix}.p0"
            self.declared.add(f"declare {self.real} {name}(ptr, i32, {self.truth}, {self.real})")
            rest = f"i32 8, {self.truth} %mask, {self.real} zeroinitializer"
            self.put(f"{out} = call {self.real} {name}(ptr {pointer}, {rest})")

    def give(self, value: str, port: int, k: int, place: int) -> None:
        """Store number k of a port."""
        self.put_at(value, self.pointer(port, k, f"give{place}"), self.layouts[port])

    def put_at(self, value: str, pointer: str, layout: Layout) -> None:
        if self.width == 1 or layout is Layout.BLOCKS:
            self.put(f"store {self.real} {value}, ptr {pointer}, align 8")
        elif layout is Layout.ROWS:
            self.scatter(value, pointer)
        else:
            name = f"@llvm.masked.store{self.suffix}.p0"
            self.declared.add(f"declare void {name}({self.real}, ptr, i32, {self.truth})")
            self.put(f"call void {name}({self.real} {value}, ptr {pointer}, i32 8, {self.truth} %mask)")

    def take_rows(self, wanted: Sequence[tuple[int, int, int, str]]) -> None:
        """Load numbers (port, which, place, name) of ports in rows: of a whole group by whole rows, else one by one."""
        few, whole, out = self.block(), self.block(), self.block()
        self.put(f"br i1 %full, label %{whole}, label %{few}")
        self.label(few)
        for port, k, place, name in wanted:
            self.take(f"{name}.few", port, k, place)
        self.put(f"br label %{out}")
        self.label(whole)
        found = {}
        for port in dict.fromkeys(port for port, *_ in wanted):
            for k, name in enumerate(self.load_rows(self.lane_pointers(port), self.program.ports[port])):
                found[port, k] = name
        self.put(f"br label %{out}")
        self.label(out)
        for port, k, _, name in wanted:
            self.put(f"{name} = phi {self.real} [ {name}.few, %{few} ], [ {found[port, k]}, %{whole} ]")

    def give_rows(self, given: Sequence[tuple[int, int, int, str]]) -> None:
        """Store numbers (port, which, place, value) of ports in rows, likewise where all numbers of a port change."""
        few, whole, out = self.block(), self.block(), self.block()
        self.put(f"br i1 %full, label %{whole}, label %{few}")
        self.label(few)
        for port, k, place, value in given:
            self.give(value, port, k, place)
        self.put(f"br label %{out}")
        self.label(whole)
        for port in dict.fromkeys(port for port, *_ in given):
            own = [(k, place, value) for at, k, place, value in given if at == port]
            if len(own) == self.program.ports[port]:
                self.store_rows(self.lane_pointers(port), [value for _, _, value in own])
            else:
                for k, place, value in own:
                    self.scatter(value, self.pointer(port, k, f"some{place}"))
        self.put(f"br label %{out}")
        self.label(out)

    def runs(self) -> list[tuple[int, int, int, int]]:
        """Return port, first number, place of that among all, and length of each stretch of numbers of arrays."""
        found, place = list[tuple[int, int, int, int]](), 0
        for port, count in enumerate(self.program.ports):
            for inside, numbers in itertools.groupby(range(place, place + count), self.program.cells.__contains__):
                first, *others = numbers
                if inside:
                    found.append((port, first - place, first, 1 + len(others)))
            place += count
        return found

    def copy(self, port: int, first: int, place: int, count: int, *, back: bool) -> None:
        """Copy numbers of arrays from their port into the group's own memory, or back, one after the other."""
        head, body, out, before = self.block(), self.block(), self.block(), self.here
        layout, whole, k, own = self.layouts[port], "i64", f"%k{head}", self.fresh()
        self.put(f"br label %{head}")
        self.label(head)
        self.put(f"{k} = phi i64 [ 0, %{before} ], [ {k}.next, %{body} ]")
        self.put(f"{k}.on = icmp slt i64 {k}, {count}")
        self.put(f"br i1 {k}.on, label %{body}, label %{out}")
        self.label(body)
        self.put(f"{k}.at = add i64 {k}, {place}")
        self.put(f"{k}.room = mul i64 {k}.at, {self.width}")
        self.put(f"{own} = getelementptr double, ptr %room, i64 {k}.room")
        self.put(f"{k}.number = add i64 {k}, {first}")
        apart = {Layout.ROWS: "1", Layout.BLOCKS: str(WIDE), Layout.COLUMNS: f"%stride{port}"}[layout]
        self.put(f"{k}.step = mul i64 {k}.number, {apart}")
        step = f"{k}.step"
        if layout is Layout.ROWS and self.width > 1:
            self.spread(f"{k[1:]}.steps", "i64", step)
            whole, step = self.word, f"{k}.steps"
        self.put(f"{k}.to = add {whole} %off{port}, {step}")
        self.put(f"{k}.pointer = getelementptr double, ptr %port{port}, {whole} {k}.to")
        if back:
            self.put(f"{k}.held = load {self.real}, ptr {own}, align 8")
            self.put_at(f"{k}.held", f"{k}.pointer", layout)
        else:
            self.take_at(f"{k}.held", f"{k}.pointer", layout)
            self.put(f"store {self.real} {k}.held, ptr {own}, align 8")
        self.put(f"{k}.next = add i64 {k}, 1")
        self.put(f"br label %{head}")
        self.label(out)

    def room(self, place: int, name: str) -> str:
        self.put(f"%{name}.room{place} = getelementptr double, ptr %room, i64 {place * self.width}")
        return f"%{name}.room{place}"

    def whole_text(self) -> str:
        p, width = self.program, self.width
        numbers = [(port, k) for port, count in enumerate(p.ports) for k in range(count)]
        used, pairs = self._used(), zip(p.outputs, p.inputs, strict=True)
        changed = [out is not own or place in p.cells for place, (out, own) in enumerate(pairs)]
        self.label("entry")
        if self.repeated:
            self.put(f"%room = alloca double, i64 {max(1, len(p.inputs)) * width}, align 64")
        for k, size in enumerate(p.arrays):
            self.put(f"%array{k} = alloca double, i64 {max(1, size) * width}, align 64")
        held = [*(f"port{k}" for k in range(len(p.ports))), "c", *(f"table{k}" for k in range(len(p.tables)))]
        apart = [name.replace("port", "stride").replace("table", "rows") for name in held if name != "c"]
        for k, name in enumerate(["first", "stop", "steps", *held, *apart]):
            self.put(f"%to.{name} = getelementptr i64, ptr %job, i64 {k}")
            self.put(f"%{name} = load {'ptr' if name in held else 'i64'}, ptr %to.{name}, align 8")
        for k in range(len(p.tables)):
            self.put(f"%before{k} = sub i64 %rows{k}, 1")
            self.put(f"%{'only' if width > 1 else 'last'}{k} = sitofp i64 %before{k} to double")
            if width > 1:
                self.spread(f"last{k}", "double", f"%only{k}")
        for constant in p.constants:
            self.operation(constant)
        for item in p.top.items:
            if isinstance(item, Symbol) and item.uniform:
                self.operation(item)
        self.put("br label %groups")
        self.label("groups")
        self.put("%g = phi i64 [ %first, %entry ], [ %g1, %next ]")
        self.put("%more = icmp slt i64 %g, %stop")
        self.put("br i1 %more, label %group, label %done")
        self.label("group")
        if width > 1:
            iota = ", ".join(f"i64 {k}" for k in range(width))
            self.spread("gs", "i64", "%g")
            self.spread("stops", "i64", "%stop")
            self.put(f"%own = add {self.word} %gs, <{iota}>")
            self.put(f"%mask = icmp slt {self.word} %own, %stops")
            self.put(f"%after = add i64 %g, {width}")
            self.put("%full = icmp sle i64 %after, %stop")
        self.beginnings()
        for run in self.runs():
            self.copy(*run, back=False)
        names = [f"%in{place}" if self.repeated else f"%v{own.number}" for place, own in enumerate(p.inputs)]
        in_rows = [width > 1 and self.layouts[port] is Layout.ROWS for port, _ in numbers]
        for place, name in enumerate(names):
            if used[place] and not in_rows[place] and place not in p.cells:
                self.take(name, *numbers[place], place)
        taken = [
            (*numbers[place], place, name)
            for place, name in enumerate(names)
            if used[place] and in_rows[place] and place not in p.cells
        ]
        if taken:
            self.take_rows(taken)
        for place, name in enumerate(names):
            if used[place] and self.repeated and place not in p.cells:
                self.put(f"store {self.real} {name}, ptr {self.room(place, 'take')}, align 8")
        if self.repeated:
            before, at = self.here, len(self.lines) + 2
            self.put("br label %time")
            self.label("time")
            self.lines.append("")
            for symbol, wanted in zip(p.inputs, used, strict=True):
                if wanted and symbol.detail not in p.cells:
                    room = self.room(symbol.detail, "now")
                    self.put(f"%v{symbol.number} = load {self.real}, ptr {room}, align 8")
        self.items(p.top.items)
        if self.repeated:
            for place, out in enumerate(p.outputs):
                if changed[place] and place not in p.cells:
                    self.put(f"store {self.real} {self.of(out)}, ptr {self.room(place, 'then')}, align 8")
            self.put("%t1 = add i64 %t, 1")
            self.put("%again = icmp slt i64 %t1, %steps")
            self.put("br i1 %again, label %time, label %back")
            self.lines[at] = f"  %t = phi i64 [ 0, %{before} ], [ %t1, %{self.here} ]"
            self.label("back")
        given = []
        for place, out in enumerate(p.outputs):
            if changed[place] and self.repeated and place not in p.cells:
                self.put(f"%out{place} = load {self.real}, ptr {self.room(place, 'give')}, align 8")
            if changed[place] and place not in p.cells:
                given.append((*numbers[place], place, f"%out{place}" if self.repeated else self.of(out)))
        for port, k, place, value in given:
            if not in_rows[place]:
                self.give(value, port, k, place)
        if any(in_rows[place] for *_, place, _ in given):
            self.give_rows([one for one in given if in_rows[one[2]]])
        for run in self.runs():
            self.copy(*run, back=True)
        self.put("br label %next")
        self.label("next")
        self.put(f"%g1 = add i64 %g, {width}")
        self.put("br label %groups")
        self.label("done")
        self.put("ret void")
        head = "define void @kernel(ptr noalias readonly %job) #0 {"
        wide = 'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }'
        return "\n".join([*sorted(self.declared), head, *self.lines, "}", wide, ""])

    def _used(self) -> list[bool]:
        """Return of each input whether something is computed from it, or another number becomes it."""
        pairs = zip(self.program.outputs, self.program.inputs, strict=True)
        needed = {id(out) for out, own in pairs if out is not own}

        def visit(items: Sequence[Any]) -> None:
            for item in items:
                if isinstance(item, Loop):
                    needed.update(map(id, (item.count, *item.start, *item.end)))
                    visit(item.region.items)
                elif isinstance(item, Branch):
                    needed.update(map(id, (item.condition, *item.then, *item.otherwise)))
                    visit(item.region.items)
                elif isinstance(item, For):
                    visit(item.region.items)
                elif isinstance(item, Store):
                    needed.add(id(item.value))
                else:
                    needed.update(map(id, item.operands))

        visit(self.program.top.items)
        return [id(own) in needed or own.detail in self.program.cells for own in self.program.inputs]


def kernel_text(program: Program, layouts: Sequence[Layout], width: int, *, repeated: bool = True) -> str:
    """Return a program as LLVM's text for so many arms at once."""
    return _Writer(program, layouts, width, repeated=repeated).whole_text()


class Call:
    """A kernel with what it works on; it keeps the arrays alive.

    Attributes:
        arms: how many there are.
    """

    __slots__ = ("_at", "_code", "_held", "_job", "arms")

    def __init__(self, known: _Known, given: tuple[np.ndarray, ...], steps: int) -> None:
        """Note where everything is."""
        self._code, self._held, self.arms = known.code, given, known.arms
        self._job = known.job(0, known.arms, steps, *map(_address, given), *known.apart)
        self._at = ctypes.addressof(self._job)

    def __call__(self) -> None:
        """Run it for every arm."""
        self._code.call(self._at)

    def part(self, first: int, stop: int) -> None:
        """Run it for the arms from `first`, a multiple of `WIDE`, to `stop` - 1; threads may do so at once."""
        job = type(self._job).from_buffer_copy(self._job)
        job[0], job[1] = first, stop
        self._code.call(ctypes.addressof(job))

    @property
    def entry(self) -> tuple[Callable[[int], None], int]:
        """What `__call__` calls, and with what, for the fewest steps of the interpreter; this object must live on."""
        return self._code.call, self._at


class _Known(NamedTuple):
    """What follows from the shapes of arrays, constants and tables.

    Attributes:
        shapes: with strides and types.
        arms: how many.
        job: array of first arm, last arm + 1, steps, where each array is, and `apart`.
        apart: how far the rows of each array lie apart, and how many each table has.
        code: the machine code.
    """

    shapes: list[Any]
    arms: int
    job: Any
    apart: list[int]
    code: _Code


class Kernel:
    """A program that runs on arrays in place.

    One arm, or a few, are run one after the other, and many in groups of `WIDE`; machine code is made when it is first
    needed.

    Args:
        program: what is run.
        layouts: of the arrays of its ports; by default all in rows.
        repeated: whether it may take more than one step in a call.
    """

    def __init__(self, program: Program, layouts: Sequence[Layout] = (), *, repeated: bool = False) -> None:
        """Keep the program."""
        self.program, self.repeated = program, repeated
        self.layouts = tuple(layouts) or (Layout.ROWS,) * len(program.ports)
        # The port that says how many arms there are: blocks may have room for more.
        self._counted = next(port for port, layout in enumerate(self.layouts) if layout is not Layout.BLOCKS)
        self._codes: dict[int, _Code] = {}
        self._known: _Known | None = None

    def __call__(
        self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray] = (), steps: int = 1
    ) -> None:
        """Run the program for every arm, `steps` times, what it returns in the place of what it is given.

        Arguments, their shapes and errors as for `bound`; `steps` at least 1.
        """
        self.bound(arrays, constants, tables, steps)()

    def bound(
        self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray] = (), steps: int = 1
    ) -> Call:
        """Return the kernel with what it works on.

        Args:
            arrays: of each port, float64, see `Layout`.
            constants: (k,) float64.
            tables: float64, in the shapes that the program knows; any number of rows is at least one.
            steps: at least 1.

        Raises:
            ValueError: an array has another shape, type or layout.
        """
        given = (*arrays, constants, *tables)
        shapes = [(array.shape, array.strides, array.dtype) for array in given]
        known = self._known
        if known is None or known.shapes != shapes:
            known = self._known = self._checked(arrays, constants, tables, shapes)
        return Call(known, given, steps)

    def _checked(
        self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray], shapes: list[Any]
    ) -> _Known:
        """Return what follows from the shapes of the arguments of `bound`."""
        program = self.program
        if (len(tables), len(arrays)) != (len(program.tables), len(program.ports)):
            raise ValueError(f"needed: {len(program.ports)} arrays and {len(program.tables)} tables")
        good = constants.dtype == _DOUBLE and constants.flags.c_contiguous
        if not good or constants.shape != (len(program.constants),):
            raise ValueError(f"needed: {len(program.constants)} constants of type float64, side by side")
        first = arrays[self._counted]
        arms = (first.shape or (0,))[0 if self.layouts[self._counted] is Layout.ROWS else -1]
        for port, (array, numbers, layout) in enumerate(zip(arrays, program.ports, self.layouts, strict=True)):
            shape, good = array.shape, array.dtype == _DOUBLE and array.ndim >= _AXES
            apart, step = (array.strides[0], array.strides[-1]) if shape else (0, 0)
            if layout is Layout.ROWS:
                good = good and shape == (arms, numbers) and (step == _SIZE or numbers <= 1)
            elif layout is Layout.COLUMNS:
                good = good and shape == (numbers, arms) and (step == _SIZE or arms <= 1)
            else:
                good = good and shape == (-(-arms // WIDE), numbers, WIDE) and array.flags.c_contiguous
            if not good or apart % _SIZE:
                raise ValueError(
                    f"array {port} of {arms} arms has shape {shape}, type {array.dtype} and strides {array.strides}; "
                    f"needed: {numbers} numbers of an arm in {layout.name.lower()}, float64"
                )
        for table, (array, shape) in enumerate(zip(tables, program.tables, strict=True)):
            good = array.ndim > 0 and array.shape[1:] == shape[1:] and len(array) == (shape[0] or max(len(array), 1))
            if not (good and array.flags.c_contiguous and array.dtype == _DOUBLE):
                raise ValueError(f"table {table} has shape {array.shape}; needed: {('rows', *shape[1:])} of float64")
        lengths = [*(array.strides[0] // _SIZE for array in arrays), *map(len, tables)]
        job = ctypes.c_int64 * (3 + len(shapes) + len(lengths))
        return _Known(shapes, arms, job, lengths, self.code(arms))

    def code(self, arms: int) -> _Code:
        """Return the machine code for so many arms."""
        width = WIDE if arms >= WIDE // 2 else 1
        code = self._codes.get(width)
        if code is None:
            text = kernel_text(self.program, self.layouts, width, repeated=self.repeated)
            code = self._codes[width] = _machine_code(text, width)
        return code


def _address(array: np.ndarray) -> int:
    """Return where an array begins."""
    try:  # three times as fast as the other way, but not for arrays with gaps or that are read-only
        return ctypes.addressof(_BYTE.from_buffer(array))  # type: ignore[arg-type]
    except (BufferError, TypeError, ValueError):
        return int(array.__array_interface__["data"][0])


_BYTE = ctypes.c_char
_AXES, _DOUBLE, _SIZE = 2, np.dtype(np.float64), 8


class _Code:
    """Machine code in memory: the engine that holds it, and its entry."""

    def __init__(self, binary: bytes, machine: Any, width: int) -> None:
        self.engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self.engine.add_object_file(llvm.ObjectFileRef.from_data(binary))
        self.engine.finalize_object()
        address = self.engine.get_function_address("kernel")
        # One arm takes a microsecond: there it is not worth to let other threads run.
        kind = ctypes.CFUNCTYPE if width > 1 else ctypes.PYFUNCTYPE
        self.call = kind(None, ctypes.c_void_p)(address)


@functools.lru_cache(maxsize=512)
def _machine_code(text: str, width: int) -> _Code:
    """Return the machine code of a text, from the file of its digest if there is one."""
    level = _LEVELS[width]
    machine = _machine(level)
    features = llvm.get_host_cpu_features().flatten()
    version = ".".join(map(str, llvm.llvm_version_info))
    key = "\n".join([text, llvm.get_host_cpu_name(), features, str(level), version])
    path = _folder() / f"{hashlib.sha256(key.encode()).hexdigest()}.o"
    binary = _stored(path)
    if binary is None:
        module = llvm.parse_assembly(text)
        options = llvm.create_pipeline_tuning_options(speed_level=level)
        options.slp_vectorization = options.loop_vectorization = width == 1
        builder = llvm.create_pass_builder(machine, options)
        builder.getModulePassManager().run(module, builder)
        binary = machine.emit_object(module)
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_atomically(path, hashlib.sha256(binary).digest() + binary)
    return _Code(binary, machine, width)


def _stored(path: Path) -> bytes | None:
    """Return the machine code in a file; None if there is none, or if it is not what was written."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    size = hashlib.sha256().digest_size
    return content[size:] if hashlib.sha256(content[size:]).digest() == content[:size] else None


def _folder() -> Path:
    """Return the folder of machine code."""
    if named := os.environ.get(CACHE):
        return Path(named)
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home) / "fuzzyarm"


def _machine(level: int) -> Any:
    """Return LLVM's machine for this processor; a new one each time, since an engine keeps it."""
    _initialise()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=level
    )


@functools.cache
def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
