"""A recorded program as LLVM's text, which takes the numbers of groups of arms, computes, and puts them back."""

from __future__ import annotations

import enum
import itertools
from collections.abc import Sequence
from typing import Any

from fuzzyarm.numbers.llvm_operations import EIGHT, Operations
from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.regions import Branch, For, Loop, Store
from fuzzyarm.numbers.symbols import Symbol

__all__ = ["WIDE", "Layout", "Writer", "kernel_text"]

WIDE = 16
"""Arms at once where there are many."""


class Layout(enum.Enum):
    """How the numbers of a port lie in its array.

    `ROWS`: (arms, numbers), the numbers of an arm side by side, rows may lie apart. `COLUMNS`: (numbers, arms), the
    arms side by side. `BLOCKS`: (blocks, numbers, `WIDE`), `WIDE` arms in each block; there may be room for more arms
    in the last one, which is written to, too.
    """

    ROWS = enum.auto()
    COLUMNS = enum.auto()
    BLOCKS = enum.auto()


class Writer(Operations):
    """Writes the whole text, for a processor that is given a job and takes its arms group by group.

    Another processor has its own `head`, `arguments` and `tail`.
    """

    def __init__(self, program: Program, layouts: Sequence[Layout], width: int, *, repeated: bool) -> None:
        super().__init__(program, width)
        self.layouts, self.repeated = layouts, repeated or bool(program.cells)

    def store_rows(self, pointers: Sequence[str], values: Sequence[str]) -> None:
        """Store vectors so that the numbers of each arm lie side by side at its pointer."""
        for first in range(0, len(values), EIGHT):
            numbers = values[first : first + EIGHT]
            for half in range(0, self.width, EIGHT):
                columns = [self.shuffle(self.width, one, "poison", range(half, half + EIGHT)) for one in numbers]
                lanes = self.transposed([*columns, *["poison"] * (EIGHT - len(columns))])
                for pointer, lane in zip(pointers[half:], lanes, strict=False):
                    at, size = self.fresh(), len(numbers)
                    self.put(f"{at} = getelementptr double, ptr {pointer}, i64 {first}")
                    one = lane if size == EIGHT else self.shuffle(EIGHT, lane, "poison", range(size))
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
        """Load a number from where the group's arms have theirs."""
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
        """Store a number there."""
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
        """Return the pointer to a number in the group's own memory."""
        self.put(f"%{name}.room{place} = getelementptr double, ptr %room, i64 {place * self.width}")
        return f"%{name}.room{place}"

    def head(self, held: Sequence[str], apart: Sequence[str]) -> str:
        """Return how the function begins; arguments as for `arguments`."""
        return "define void @kernel(ptr noalias readonly %job) #0 {"

    def arguments(self, held: Sequence[str], apart: Sequence[str]) -> tuple[str, str]:
        """Take %stop, %steps, and the pointers and whole numbers with these names.

        Returns the first arm, and how far the first arm of the next group is from it.
        """
        for k, name in enumerate(["first", "stop", "steps", *held, *apart]):
            self.put(f"%to.{name} = getelementptr i64, ptr %job, i64 {k}")
            self.put(f"%{name} = load {'ptr' if name in held else 'i64'}, ptr %to.{name}, align 8")
        return "%first", str(self.width)

    def tail(self) -> str:
        """Return what stands behind the function."""
        return 'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }'

    def whole_text(self) -> str:
        """Return the text."""
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
        first, further = self.arguments(held, apart)
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
        self.put(f"%g = phi i64 [ {first}, %entry ], [ %g1, %next ]")
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
        self.put(f"%g1 = add i64 %g, {further}")
        self.put("br label %groups")
        self.label("done")
        self.put("ret void")
        return "\n".join([*sorted(self.declared), self.head(held, apart), *self.lines, "}", self.tail(), ""])

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
    return Writer(program, layouts, width, repeated=repeated).whole_text()
