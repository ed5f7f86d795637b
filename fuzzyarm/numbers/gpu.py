"""Kernels on an NVIDIA GPU: a recorded program as PTX, launched by the driver on arrays that lie there.

Each thread computes one arm, in float64. The text is that of `llvm_text` for one arm, with three differences. The
kernel has parameters in place of a job. A thread takes the arms g, g + n, g + 2 n, ..., where g is its own number and n
the number of all threads. `logarithm` replaces the C library's. Arrays of ports are those of the kernel on the
processor: in `COLUMNS` and `BLOCKS` neighbouring threads read neighbouring numbers. A program's own arrays lie in the
thread's local memory.

The PTX has been assembled, and the tests run it instruction by instruction on the host, with a driver that runs PTX on
the processor. No GPU has run it, and its speed is not measured.
"""

from __future__ import annotations

import ctypes
import functools
import re
import types
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np

from fuzzyarm.numbers.functions import bits, number, select, word
from fuzzyarm.numbers.llvm_text import CALLED, Operations, Writer
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.symbols import Symbol

__all__ = ["Gpu", "gpu", "logarithm", "ptx_of"]

_MAJOR, _MINOR = 75, 76  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_...
_NEWEST = 90  # what the tests assemble for; later processors run it, too
_BLOCK = 64  # threads; one may need 255 of a processor's 65,536 registers


class Gpu:
    """A GPU, by its number as torch counts, in its primary context, which torch uses, too.

    `driver` is the library `libcuda.so.1`, loaded by `ctypes`; `processor` names the GPU for LLVM. RuntimeError if a
    function of the driver fails; the message names it and its code.
    """

    def __init__(self, number: int, driver: Any) -> None:
        self._driver, self._functions = driver, dict[Kernel, ctypes.c_void_p]()
        device, self._context, capability = ctypes.c_int(), ctypes.c_void_p(), (ctypes.c_int(), ctypes.c_int())
        self._call("cuInit", ctypes.c_uint(0))
        self._call("cuDeviceGet", ctypes.byref(device), ctypes.c_int(number))
        for one, which in zip(capability, (_MAJOR, _MINOR), strict=True):
            self._call("cuDeviceGetAttribute", ctypes.byref(one), ctypes.c_int(which), device)
        self.processor = f"sm_{min(10 * capability[0].value + capability[1].value, _NEWEST)}"
        self._call("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), device)

    def launch(
        self, kernel: Kernel, arrays: Sequence[Any], constants: Any, tables: Sequence[Any], steps: int, stream: int
    ) -> None:
        """Begin to run a kernel for every arm, `steps` times, in a stream of this GPU; this does not wait for its end.

        Arguments are as for `Kernel.bound`, objects with `__cuda_array_interface__` such as tensors of torch. The
        caller keeps them alive until the stream has finished.
        """
        held = [_placed(one) for one in (*arrays, constants, *tables)]
        count = len(arrays)
        arms, lengths = kernel.shapes(held[:count], held[count], held[count + 1 :])
        places = [one.__array_interface__["data"][0] for one in held]
        given = [ctypes.c_int64(one) for one in (arms, steps, *places, *lengths)]
        pointers = (ctypes.c_void_p * len(given))(*map(ctypes.addressof, given))
        grid = [ctypes.c_uint(k) for k in (-(-arms // _BLOCK), 1, 1, _BLOCK, 1, 1, 0)]
        self._call("cuCtxPushCurrent_v2", self._context)
        try:
            function = self._function(kernel)
            self._call("cuLaunchKernel", function, *grid, ctypes.c_void_p(stream), pointers, ctypes.c_void_p())
        finally:
            self._call("cuCtxPopCurrent_v2", ctypes.byref(ctypes.c_void_p()))

    def _function(self, kernel: Kernel) -> ctypes.c_void_p:
        """Return the kernel on the GPU, whose context is the current one."""
        if kernel not in self._functions:
            written, module, function = ptx_of(kernel, processor=self.processor), ctypes.c_void_p(), ctypes.c_void_p()
            self._call("cuModuleLoadData", ctypes.byref(module), ctypes.c_char_p(written.text.encode()))
            self._call("cuModuleGetFunction", ctypes.byref(function), module, ctypes.c_char_p(written.name.encode()))
            self._functions[kernel] = function
        return self._functions[kernel]

    def _call(self, name: str, *arguments: Any) -> None:
        if code := getattr(self._driver, name)(*arguments):
            raise RuntimeError(f"the CUDA driver's {name} failed with code {code}")


def _placed(array: Any) -> np.ndarray:
    """Return an array of a GPU for its shape, strides, type and place; its numbers cannot be read."""
    described = {**array.__cuda_array_interface__, "version": 3}
    return np.asarray(types.SimpleNamespace(__array_interface__=described))


@functools.cache
def gpu(number: int) -> Gpu:
    """Return a GPU by its number, always the same."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError as error:
        raise RuntimeError(f"no NVIDIA driver: {error}") from None
    return Gpu(number, driver)


class _Ptx(NamedTuple):
    """A kernel in PTX: the module, the kernel's name in it, and the names of its parameters.

    These are 8 bytes each: `stop`, the number of arms, and `steps`, both int64; the address of each array `port0`, ...,
    of the constants `c` and of each table `table0`, ...; how far the rows of each array lie apart, `stride0`, ..., in
    numbers; and the rows of each table, `rows0`, .... Constants and tables lie apart from all arrays.
    """

    text: str
    name: str
    parameters: tuple[str, ...]


def logarithm(x: Any) -> Any:
    """Return ln x within one unit in the last place; -inf for 0, and nan below (`e_log.c` of fdlibm).

    x = 2^k (1 + f), √½ ≤ 1 + f < √2, s = f / (2 + f), R of degree 14 in s: ln(1 + f) = f - (f²/2 - s (f²/2 + R)).
    """
    # Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved. Permission to use, copy, modify, and distribute
    # this software is freely granted, provided that this notice is preserved.
    small = x < 2.0**-1022
    of = word(select(small, x * 2.0**54, x))
    exponent = of >> 52
    mantissa = bits(of + exponent * (2**64 - 2**52) + (1023 << 52))  # 1 <= mantissa < 2
    high = mantissa > 2.0**0.5
    k = number(exponent) - 1023.0 + 1.0 * high - 54.0 * small
    f = select(high, 0.5 * mantissa, mantissa) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    odd = z * (_LG[0] + w * (_LG[2] + w * (_LG[4] + w * _LG[6])))
    even = w * (_LG[1] + w * (_LG[3] + w * _LG[5]))
    half = 0.5 * f * f
    found = k * _LN2_HIGH - ((half - (s * (half + (even + odd)) + k * _LN2_LOW)) - f)
    special = select(x == 0.0, -float("inf"), select(x > 0.0, x, float("nan")))
    return select((x > 0.0) & (x < float("inf")), found, special)


_LG = (
    6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
    1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01,
)  # fmt: skip
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10

_NATIVE = {"abs", "floor", "rint", "sqrt"}  # what PTX has instructions for
_OWN: dict[str, Callable[[Any], Any]] = {"log": logarithm}
_ROUNDS_ONCE = re.compile(r"\bfma\.|\b(?:add|sub|mul)\.f64")  # without .rn an assembler may fuse them
_TRIPLE = "nvptx64-nvidia-cuda"
_THREADS = """
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.nctaid.x()
define internal i64 @product(i32 %a, i32 %b) alwaysinline {
  %x = zext i32 %a to i64
  %y = zext i32 %b to i64
  %z = mul i64 %x, %y
  ret i64 %z
}
define internal i64 @thread() alwaysinline {
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %size = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %inside = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %before = call i64 @product(i32 %block, i32 %size)
  %own = zext i32 %inside to i64
  %place = add i64 %before, %own
  ret i64 %place
}
define internal i64 @threads() alwaysinline {
  %blocks = call i32 @llvm.nvvm.read.ptx.sreg.nctaid.x()
  %size = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %all = call i64 @product(i32 %blocks, i32 %size)
  ret i64 %all
}
"""


class _GpuWriter(Writer):
    """Writes a kernel of one arm, which a thread runs for its own arms."""

    def __init__(self, kernel: Kernel, name: str) -> None:
        super().__init__(kernel.program, kernel.layouts, 1, repeated=kernel.repeated)
        self.name, self.parameters, self.own = name, tuple[str, ...](), dict[str, str]()

    def head(self, held: Sequence[str], apart: Sequence[str]) -> str:
        self.parameters = ("stop", "steps", *held, *apart)
        kinds = ["i64"] * 2 + ["ptr" if one.startswith("port") else "ptr noalias readonly" for one in held]
        kinds += ["i64"] * len(apart)
        given = ", ".join(f"{kind} %{one}" for kind, one in zip(kinds, self.parameters, strict=True))
        return f"define ptx_kernel void @{self.name}({given}) #0 {{"

    def arguments(self, held: Sequence[str], apart: Sequence[str]) -> tuple[str, str]:
        self.put("%first = call i64 @thread()")
        self.put("%threads = call i64 @threads()")
        return "%first", "%threads"

    def tail(self) -> str:
        return "\n".join([*self.own.values(), "attributes #0 = { nounwind }"])

    def operation(self, one: Symbol) -> None:
        name = one.operation
        if name in _OWN:
            self.own[name] = _function(name)
            self.put(f"{self.of(one)} = call double @own.{name}(double {self.of(one.operands[0])})")
        elif name in CALLED and name not in _NATIVE:
            raise ValueError(f"{name} has no instruction in PTX; write it in `numbers.gpu` as `logarithm` is written")
        else:
            super().operation(one)


@functools.cache
def _function(name: str) -> str:
    """Return a function of one number, which is recorded, as LLVM's text."""
    program = Program(lambda port, _: ((_OWN[name](*port),),), ((0.0,),))
    own, (x,), (result,) = Operations(program, 1), program.inputs, program.outputs
    own.put(f"{own.of(x)} = bitcast double %x to double")
    own.items(program.top.items)
    own.put(f"ret double {own.of(result)}")
    return "\n".join([f"define internal double @own.{name}(double %x) #0 {{", *own.lines, "}"])


def _gpu_text(kernel: Kernel, name: str = "kernel") -> tuple[str, tuple[str, ...]]:
    """Return a kernel as LLVM's text, and its parameters as in `_Ptx`; ValueError if PTX lacks an operation.

    The text calls `i64 @thread()`, the number of the thread, and `i64 @threads()`, their number, without defining them.
    """
    writer = _GpuWriter(kernel, name)
    text = writer.whole_text()
    return text, writer.parameters


def ptx_of(kernel: Kernel, name: str = "kernel", processor: str = "sm_90") -> _Ptx:
    """Return a kernel as PTX with a name, for a GPU as LLVM names it; ValueError for an operation that no GPU has."""
    _initialise()
    text, parameters = _gpu_text(kernel, name)
    machine = llvm.Target.from_triple(_TRIPLE).create_target_machine(cpu=processor, opt=3)
    module = llvm.parse_assembly(f'target triple = "{_TRIPLE}"\n{text}{_THREADS}')
    module.data_layout = str(machine.target_data)
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=3))
    builder.getModulePassManager().run(module, builder)
    written = machine.emit_assembly(module)
    if fused := _ROUNDS_ONCE.search(written):
        raise RuntimeError(f"LLVM {llvm.llvm_version_info} wrote {fused[0]}, which does not round twice")
    return _Ptx(written, name, parameters)


@functools.cache
def _initialise() -> None:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
