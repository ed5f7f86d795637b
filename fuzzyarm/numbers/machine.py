"""A recorded program as machine code, by LLVM: the same for one arm and for many at once, with the same bits.

The program becomes LLVM's text with vectors of `width` arms, and no operation may be contracted or reordered. Numbers
of arms stay where they are: each port is an array (arms, numbers) whose rows may lie apart; a group of `width` arms is
gathered from there, stays in the processor's first cache for all its steps, and is put back.

Machine code is kept on disk by a digest of text, processor, level and LLVM's version. A file that is not what was
written is made again, and without a folder to write there are no files.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from fuzzyarm.common.files import write_atomically
from fuzzyarm.numbers.symbols import Branch, Loop, Program, Symbol

__all__ = ["CACHE", "WIDE", "Kernel", "kernel_text"]

WIDE = 16
"""Arms at once where there are many."""

CACHE = "FUZZYARM_CACHE"
"""Environment variable with the folder for machine code; by default that of the user's caches."""

_COMPARED = {"<": "olt", "<=": "ole", ">": "ogt", ">=": "oge", "==": "oeq", "!=": "une"}
_ARITHMETIC = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
_CALLED = {"abs": "fabs", "rint": "rint", "floor": "floor", "sqrt": "sqrt"}
_LEVELS = {1: 2, WIDE: 1}  # of LLVM's optimisation, by width


def _literal(number: Any) -> str:
    return f"0x{struct.unpack('>Q', struct.pack('>d', float(number)))[0]:016X}"


class _Writer:
    """Writes a program as LLVM's text."""

    def __init__(self, program: Program, width: int) -> None:
        self.program, self.width, self.lines, self.here, self.blocks = program, width, list[str](), "entry", 0
        wide = width > 1
        self.real, self.bit = (f"<{width} x double>", f"<{width} x i1>") if wide else ("double", "i1")
        self.whole = f"<{width} x i64>" if wide else "i64"
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

    def of(self, operand: Any, *, uniform: bool = False) -> str:
        """Return the text of an operand, as one number or as one for each arm."""
        if isinstance(operand, Symbol):
            return f"%s{operand.number}" if operand.uniform and (uniform or self.width == 1) else f"%v{operand.number}"
        return _literal(operand) if uniform else self.splat("double", _literal(operand))

    def operation(self, one: Symbol) -> None:
        uniform = one.uniform
        real, bit, suffix = ("double", "i1", ".f64") if uniform else (self.real, self.bit, self.suffix)
        a = [self.of(operand, uniform=uniform) for operand in one.operands]
        out, name = f"%s{one.number}" if uniform else f"%v{one.number}", one.operation
        splat: Callable[[str, str], str] = (lambda kind, text: text) if uniform else self.splat
        if name == "shared":
            self.put(f"%p{one.number} = getelementptr double, ptr %c, i64 {one.detail}")
            self.put(f"{out} = load double, ptr %p{one.number}, align 8")
        elif name in _ARITHMETIC:
            self.put(f"{out} = {_ARITHMETIC[name]} {real} {a[0]}, {a[1]}")
        elif name in _COMPARED:
            self.put(f"{out} = fcmp {_COMPARED[name]} {real} {a[0]}, {a[1]}")
        elif name in ("&", "|"):
            self.put(f"{out} = {'and' if name == '&' else 'or'} {bit} {a[0]}, {a[1]}")
        elif name == "not":
            self.put(f"{out} = xor {bit} {a[0]}, {splat('i1', 'true')}")
        elif name == "neg":
            self.put(f"{out} = fneg {real} {a[0]}")
        elif name in _CALLED:
            self.declared.add(f"declare {real} @llvm.{_CALLED[name]}{suffix}({real})")
            self.put(f"{out} = call {real} @llvm.{_CALLED[name]}{suffix}({real} {a[0]})")
        elif name == "real":
            one_, zero = splat("double", "1.0"), splat("double", "0.0")
            self.put(f"{out} = select {bit} {a[0]}, {real} {one_}, {real} {zero}")
        elif name == "select":
            kind = bit if one.truth else real
            self.put(f"{out} = select {bit} {a[0]}, {kind} {a[1]}, {kind} {a[2]}")
        elif name == "row":
            self.row(one, out)
        else:
            raise ValueError(f"operation {name} has no machine code")
        if uniform and self.width > 1:
            kind, vector = ("i1", self.bit) if one.truth else ("double", self.real)
            self.put(f"%i{one.number} = insertelement {vector} poison, {kind} {out}, i64 0")
            self.put(
                f"%v{one.number} = shufflevector {vector} %i{one.number}, {vector} poison, "
                f"<{self.width} x i32> zeroinitializer"
            )

    def row(self, one: Symbol, out: str) -> None:
        """Look up a number of a row, whose place is within the table whatever is asked for."""
        first, columns, k = one.detail
        n, last = one.number, self.of(one.operands[1])
        zero = self.splat("double", "0.0")
        self.put(f"%a{n} = fcmp ogt {self.real} {self.of(one.operands[0])}, {zero}")  # not for nan
        self.put(f"%b{n} = select {self.bit} %a{n}, {self.real} {self.of(one.operands[0])}, {self.real} {zero}")
        self.put(f"%d{n} = fcmp olt {self.real} %b{n}, {last}")
        self.put(f"%e{n} = select {self.bit} %d{n}, {self.real} %b{n}, {self.real} {last}")
        self.put(f"%x{n} = fptosi {self.real} %e{n} to {self.whole}")
        self.put(f"%y{n} = mul nsw {self.whole} %x{n}, {self.splat('i64', str(columns))}")
        self.put(f"%z{n} = add nsw {self.whole} %y{n}, {self.splat('i64', str(first + k))}")
        self.put(f"%p{n} = getelementptr double, ptr %c, {self.whole} %z{n}")
        if self.width == 1:
            self.put(f"{out} = load double, ptr %p{n}, align 8")
        else:
            self.gather(out, f"%p{n}", "splat (i1 true)")

    def gather(self, out: str, places: str, mask: str) -> None:
        name = f"@llvm.masked.gather{self.suffix}.v{self.width}p0"
        pointers = f"<{self.width} x ptr>"
        self.declared.add(f"declare {self.real} {name}({pointers}, i32, {self.bit}, {self.real})")
        self.put(f"{out} = call {self.real} {name}({pointers} {places}, i32 8, {self.bit} {mask}, {self.real} zeroinitializer)")

    def scatter(self, value: str, places: str, mask: str) -> None:
        name = f"@llvm.masked.scatter{self.suffix}.v{self.width}p0"
        pointers = f"<{self.width} x ptr>"
        self.declared.add(f"declare void {name}({self.real}, {pointers}, i32, {self.bit})")
        self.put(f"call void {name}({self.real} {value}, {pointers} {places}, i32 8, {self.bit} {mask})")

    def items(self, items: Sequence[Any]) -> None:
        for item in items:
            if isinstance(item, Loop):
                self.loop(item)
            elif isinstance(item, Branch):
                self.branch(item)
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
        self.items(one.region.items)
        self.put(f"%m{head} = add i64 %k{head}, 1")
        self.put(f"br label %{head}")
        phis = [f"  %k{head} = phi i64 [ 0, %{before} ], [ %m{head}, %{self.here} ]"]
        for inside, start, end in zip(one.inside, one.start, one.end, strict=True):
            phis.append(
                f"  %v{inside.number} = phi {self.real} [ {self.of(start)}, %{before} ], [ {self.of(end)}, %{self.here} ]"
            )
        self.lines[at] = "\n".join(phis)
        self.label(out)
        for inside, after in zip(one.inside, one.after, strict=True):  # another name for the same number
            self.put(f"%v{after.number} = bitcast {self.real} %v{inside.number} to {self.real}")

    def branch(self, one: Branch) -> None:
        then, out, test = self.block(), self.block(), self.of(one.condition)
        if self.width > 1:
            name = f"@llvm.vector.reduce.or.v{self.width}i1"
            self.declared.add(f"declare i1 {name}({self.bit})")
            self.put(f"%t{then} = call i1 {name}({self.bit} {test})")
            test = f"%t{then}"
        before = self.here
        self.put(f"br i1 {test}, label %{then}, label %{out}")
        self.label(then)
        self.items(one.region.items)
        for first, second, after in zip(one.then, one.otherwise, one.after, strict=True):
            pair = f"{self.real} {self.of(first)}, {self.real} {self.of(second)}"
            self.put(f"%u{after.number} = select {self.bit} {self.of(one.condition)}, {pair}")
        last = self.here
        self.put(f"br label %{out}")
        self.label(out)
        for second, after in zip(one.otherwise, one.after, strict=True):
            pair = f"[ {self.of(second)}, %{before} ], [ %u{after.number}, %{last} ]"
            self.put(f"%v{after.number} = phi {self.real} {pair}")

    def ports(self, visit: Callable[[int, str], None], wanted: Sequence[bool], name: str) -> None:
        """Visit each wanted number of all ports with the pointers of its group's arms."""
        place = 0
        for port, numbers in enumerate(self.program.ports):
            for k in range(numbers):
                if wanted[place]:
                    at, pointer = f"{name}.at{place}", f"%{name}.pointer{place}"
                    self.put(f"%{at} = add {self.whole} %off{port}, {self.splat('i64', str(k))}")
                    self.put(f"{pointer} = getelementptr double, ptr %port{port}, {self.whole} %{at}")
                    visit(place, pointer)
                place += 1

    def room(self, place: int, name: str) -> str:
        self.put(f"%{name}.room{place} = getelementptr double, ptr %room, i64 {place * self.width}")
        return f"%{name}.room{place}"

    def whole_text(self) -> str:
        p, width, align = self.program, self.width, 8
        self.label("entry")
        self.put(f"%room = alloca double, i64 {max(1, len(p.inputs)) * width}, align 64")
        for port in range(len(p.ports)):
            self.put(f"%pp{port} = getelementptr ptr, ptr %ports, i64 {port}")
            self.put(f"%port{port} = load ptr, ptr %pp{port}, align 8")
            self.put(f"%ps{port} = getelementptr i64, ptr %strides, i64 {port}")
            self.put(f"%stride{port} = load i64, ptr %ps{port}, align 8")
        for constant in p.constants:
            self.operation(constant)
        for item in p.top.items:
            if isinstance(item, Symbol) and item.uniform:
                self.operation(item)
        self.put("br label %groups")
        self.label("groups")
        self.put("%g = phi i64 [ 0, %entry ], [ %g1, %next ]")
        self.put("%more = icmp slt i64 %g, %arms")
        self.put("br i1 %more, label %group, label %done")
        self.label("group")
        if width > 1:
            iota = ", ".join(f"i64 {k}" for k in range(width))
            for name, number in (("g", "%g"), ("arms", "%arms")):
                self.put(f"%{name}i = insertelement {self.whole} poison, i64 {number}, i64 0")
                self.put(f"%{name}v = shufflevector {self.whole} %{name}i, {self.whole} poison, <{width} x i32> zeroinitializer")
            self.put(f"%own = add {self.whole} %gv, <{iota}>")
            self.put(f"%mask = icmp slt {self.whole} %own, %armsv")
        for port in range(len(p.ports)):
            if width > 1:
                self.put(f"%sti{port} = insertelement {self.whole} poison, i64 %stride{port}, i64 0")
                self.put(
                    f"%stv{port} = shufflevector {self.whole} %sti{port}, {self.whole} poison, "
                    f"<{width} x i32> zeroinitializer"
                )
                self.put(f"%off{port} = mul {self.whole} %own, %stv{port}")
            else:
                self.put(f"%off{port} = mul i64 %g, %stride{port}")
        used = self._used()

        def take(place: int, pointers: str) -> None:
            if width > 1:
                self.gather(f"%in{place}", pointers, "%mask")
            else:
                self.put(f"%in{place} = load double, ptr {pointers}, align {align}")
            self.put(f"store {self.real} %in{place}, ptr {self.room(place, 'take')}, align {align}")

        self.ports(take, used, "take")
        self.put("br label %time")
        before = self.here
        self.label("time")
        at = len(self.lines)
        self.lines.append("")
        for symbol, wanted in zip(p.inputs, used, strict=True):
            if wanted:
                where = self.room(symbol.detail, "t")
                self.put(f"%v{symbol.number} = load {self.real}, ptr {where}, align {align}")
        self.items(p.top.items)
        changed = [out is not own for out, own in zip(p.outputs, p.inputs, strict=True)]
        for place, out in enumerate(p.outputs):
            if changed[place]:
                self.put(f"store {self.real} {self.of(out)}, ptr {self.room(place, 'then')}, align {align}")
        self.put("%t1 = add i64 %t, 1")
        self.put("%again = icmp slt i64 %t1, %steps")
        self.put("br i1 %again, label %time, label %back")
        self.lines[at] = f"  %t = phi i64 [ 0, %{before} ], [ %t1, %{self.here} ]"
        self.label("back")

        def give(place: int, pointers: str) -> None:
            self.put(f"%out{place} = load {self.real}, ptr {self.room(place, 'give')}, align {align}")
            if width > 1:
                self.scatter(f"%out{place}", pointers, "%mask")
            else:
                self.put(f"store double %out{place}, ptr {pointers}, align {align}")

        self.ports(give, changed, "give")
        self.put("br label %next")
        self.label("next")
        self.put(f"%g1 = add i64 %g, {width}")
        self.put("br label %groups")
        self.label("done")
        self.put("ret void")
        head = "define void @kernel(ptr noalias %ports, ptr noalias %strides, ptr noalias readonly %c, i64 %arms, i64 %steps) #0 {"
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
                else:
                    needed.update(map(id, item.operands))

        visit(self.program.top.items)
        return [id(own) in needed for own in self.program.inputs]


def kernel_text(program: Program, width: int) -> str:
    """Return a program as LLVM's text for so many arms at once."""
    return _Writer(program, width).whole_text()


class Kernel:
    """A program that runs on arrays in place.

    One arm, or a few, are run one after the other, and many in groups of `WIDE`; machine code is made when it is first
    needed.
    """

    def __init__(self, program: Program) -> None:
        """Keep the program."""
        self.program = program
        self._run: dict[int, Any] = {}

    def __call__(self, arrays: Sequence[np.ndarray], constants: np.ndarray, steps: int = 1) -> None:
        """Run the program for every arm, `steps` times, what it returns in the place of what it is given.

        Args:
            arrays: of each port, (arms, numbers), float64; the numbers of an arm lie side by side.
            constants: (k,) float64, the constants and then the tables, row by row.
            steps: at least 1.

        Raises:
            ValueError: an array has another shape, type or layout.
        """
        ports, arms = self.program.ports, len(arrays[0])
        beyond = constants.size - self.program.numbers
        rest = beyond % self.program.open if self.program.open and beyond > 0 else beyond
        if len(arrays) != len(ports) or rest or constants.ndim != 1 or constants.dtype != np.float64:
            raise ValueError(f"needed: {len(ports)} arrays and {self.program.numbers} constants of type float64")
        places, strides = (ctypes.c_void_p * len(ports))(), (ctypes.c_int64 * len(ports))()
        for port, (array, numbers) in enumerate(zip(arrays, ports, strict=True)):
            row, step = array.strides if array.ndim == _AXES else (0, 0)
            apart = step == array.itemsize or numbers <= 1
            if array.shape != (arms, numbers) or array.dtype != np.float64 or not apart or row % array.itemsize:
                raise ValueError(
                    f"array {port} has shape {array.shape}, type {array.dtype} and strides {array.strides}; needed: "
                    f"({arms}, {numbers}) of float64, the numbers of a row side by side"
                )
            places[port], strides[port] = array.ctypes.data, row // array.itemsize
        if not (arms and steps > 0):
            return
        width = WIDE if arms >= WIDE // 2 else 1
        run = self._run.get(width)
        if run is None:
            run = self._run[width] = _machine_code(kernel_text(self.program, width), _LEVELS[width])
        run.call(places, strides, constants.ctypes.data, arms, steps)


_AXES = 2


class _Code:
    """Machine code in memory: the engine that holds it, and its entry."""

    def __init__(self, binary: bytes, machine: Any) -> None:
        self.engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self.engine.add_object_file(llvm.ObjectFileRef.from_data(binary))
        self.engine.finalize_object()
        address = self.engine.get_function_address("kernel")
        pointers, whole = [ctypes.c_void_p] * 3, [ctypes.c_int64] * 2
        self.call = ctypes.CFUNCTYPE(None, *pointers, *whole)(address)


@functools.lru_cache(maxsize=512)
def _machine_code(text: str, level: int) -> _Code:
    """Return the machine code of a text, from the file of its digest if there is one."""
    machine = _machine(level)
    features = llvm.get_host_cpu_features().flatten()
    version = ".".join(map(str, llvm.llvm_version_info))
    key = "\n".join([text, llvm.get_host_cpu_name(), features, str(level), version])
    path = _folder() / f"{hashlib.sha256(key.encode()).hexdigest()}.o"
    binary = _stored(path)
    if binary is None:
        module = llvm.parse_assembly(text)
        options = llvm.create_pipeline_tuning_options(speed_level=level)
        options.slp_vectorization = options.loop_vectorization = False
        builder = llvm.create_pass_builder(machine, options)
        builder.getModulePassManager().run(module, builder)
        binary = machine.emit_object(module)
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_atomically(path, hashlib.sha256(binary).digest() + binary)
    return _Code(binary, machine)


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
