"""A recorded program as machine code, compiled by LLVM; one arm and many at once give the same bits.

The program becomes LLVM text with vectors of `width` arms, and no operation may be contracted or reordered. Each
arm's numbers stay in arrays, see `PortLayout`; those of `width` arms are loaded once for all steps.

Machine code is kept on disk under a digest of text, processor, optimisation level and LLVM's version. A damaged file is
replaced; without a writable folder no files are written.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import struct
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from fuzzyarm.common.files import write_atomically
from fuzzyarm.common.waiting import announced
from fuzzyarm.numbers._llvm_text import EIGHT, WIDE, PortLayout, kernel_text
from fuzzyarm.numbers.program import Program

__all__ = ["WIDE", "Call", "Kernel", "PortLayout", "kernel_text"]

_CACHE = "FUZZYARM_CACHE"  # environment variable with the folder for machine code; by default the user's cache folder
_LASTING = 0.5  # s of compiling, after which a message is printed; a first reset compiles two kernels
_LONG = 2500  # operations; in a longer program the numbers of `WIDE` arms would not stay in registers


class Call:
    """A kernel bound to the arrays of `arms` arms, on which each call runs it; it keeps the arrays alive."""

    __slots__ = ("_code", "_held", "_job", "arms")

    def __init__(self, known: _Known, given: tuple[np.ndarray, ...], steps: int) -> None:
        self._code, self._held, self.arms = known.code, given, known.arms
        self._job = known.job(steps, map(_address, given))

    def __call__(self) -> None:
        """Run the kernel for every arm."""
        self._code.call(self._job)

    def part(self, first: int, stop: int) -> None:
        """Run the kernel for arms `first`, a multiple of `WIDE`, to `stop` - 1; threads may run parts at once."""
        self._code.call(_SPAN.pack(first, stop) + self._job[_SPAN.size :])

    def on(self, port: int, array: np.ndarray) -> None:
        """Use another array of the same shape, strides and type for a port; the caller must keep it alive."""
        at = _SPAN.size + _SIZE * (1 + port)
        self._job = self._job[:at] + _ADDRESS.pack(_address(array)) + self._job[at + _SIZE :]

    def release(self) -> None:
        """Drop the references to the arrays; the caller must keep the arrays alive."""
        self._held = ()

    @property
    def entry(self) -> tuple[Callable[[bytes], None], bytes]:
        """A function f and its argument x: f(x) does what `__call__` does, but faster. Keep this object alive."""
        return self._code.call, self._job


class _Known:
    """The machine code of a kernel for arrays, constants and tables of certain shapes.

    `apart` lists the distance between the rows of each array, in float64 values, then the number of rows of each table.
    """

    def __init__(
        self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Any, arms: int, apart: list[int], code: _Code
    ) -> None:
        self.constants, self.tables = constants, tables
        self.arms, self.code, self._apart = arms, code, apart
        self._arrays, self._rest = _shapes(arrays), _shapes((self.constants, *self.tables))
        self._pack = struct.Struct(f"{3 + len(arrays) + 1 + len(self.tables) + len(apart)}q").pack
        self._places = [_address(array) for array in (self.constants, *self.tables)]

    def fits(self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray]) -> bool:
        """Return whether arrays, constants and tables have the shapes, strides and types this object was made for."""
        same = constants is self.constants and tables is self.tables
        return _shapes(arrays) == self._arrays and (same or _shapes((constants, *tables)) == self._rest)

    def job(self, steps: int, places: Iterable[int]) -> bytes:
        """Return the packed argument for `steps` steps of the machine code on data at the addresses `places`."""
        return self._pack(0, self.arms, steps, *places, *self._apart)

    def run(
        self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray], steps: int
    ) -> None:
        """Run the machine code for every arm, `steps` times, in place; other arguments as for `Kernel.bound`."""
        places = self._places
        if constants is not self.constants or tables is not self.tables:
            places = [_address(array) for array in (constants, *tables)]
        self.code.call(self._pack(0, self.arms, steps, *map(_address, arrays), *places, *self._apart))


def _shapes(arrays: Iterable[np.ndarray]) -> list[Any]:
    return [(array.shape, array.strides, array.dtype) for array in arrays]


class Kernel:
    """A program that runs on arrays in place; if `repeated`, a call can run several steps.

    `layouts` has the layout of each port's array, by default `ROWS`. A few arms are computed one by one, many in groups
    of `WIDE`, or of `EIGHT` if the program is long. Machine code is compiled when it is first needed.
    """

    def __init__(self, program: Program, layouts: Sequence[PortLayout] = (), *, repeated: bool = False) -> None:
        self.program, self.repeated = program, repeated
        self.layouts = tuple(layouts) or (PortLayout.ROWS,) * len(program.ports)
        # The port that gives the number of arms; blocks may have room for more.
        self._counted = next(port for port, layout in enumerate(self.layouts) if layout is not PortLayout.BLOCKS)
        self._codes: dict[int, _Code] = {}
        self._known: _Known | None = None

    def __call__(
        self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray] = (), steps: int = 1
    ) -> None:
        """Run the program for every arm, `steps` times, in place; other arguments as for `bound`."""
        self._fitting(arrays, constants, tables).run(arrays, constants, tables, steps)

    def bound(
        self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray] = (), steps: int = 1
    ) -> Call:
        """Return the kernel bound to arrays; a call runs `steps` steps.

        All are float64: an array for each port, see `PortLayout`; constants (k,); tables in the program's shapes,
        with at least one row. ValueError for another shape, type or layout.
        """
        return Call(self._fitting(arrays, constants, tables), (*arrays, constants, *tables), steps)

    def _fitting(self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray]) -> _Known:
        known = self._known
        if known is None or not known.fits(arrays, constants, tables):
            known = self._known = self._checked(arrays, constants, tables)
        return known

    def _checked(self, arrays: Sequence[np.ndarray], constants: np.ndarray, tables: Sequence[np.ndarray]) -> _Known:
        program = self.program
        if (len(tables), len(arrays)) != (len(program.tables), len(program.ports)):
            raise ValueError(
                f"{len(arrays)} array(s) and {len(tables)} table(s) were given; the program takes {len(program.ports)} "
                f"and {len(program.tables)}"
            )
        good = constants.dtype == _DOUBLE and constants.flags.c_contiguous
        if not good or constants.shape != (len(program.constants),):
            raise ValueError(
                f"the constants have shape {constants.shape} and type {constants.dtype}; they must be a contiguous "
                f"float64 array of shape ({len(program.constants)},)"
            )
        first = arrays[self._counted]
        arms = (first.shape or (0,))[0 if self.layouts[self._counted] is PortLayout.ROWS else -1]
        for port, (array, numbers, layout) in enumerate(zip(arrays, program.ports, self.layouts, strict=True)):
            shape, good = array.shape, array.dtype == _DOUBLE and array.ndim >= _AXES
            apart, step = (array.strides[0], array.strides[-1]) if shape else (0, 0)
            if layout is PortLayout.ROWS:
                good = good and shape == (arms, numbers) and (step == _SIZE or numbers <= 1)
            elif layout is PortLayout.COLUMNS:
                good = good and shape == (numbers, arms) and (step == _SIZE or arms <= 1)
            else:
                good = good and shape == (-(-arms // WIDE), numbers, WIDE) and array.flags.c_contiguous
            if not good or apart % _SIZE:
                raise ValueError(
                    f"array {port} (for {arms} arms) has shape {shape}, type {array.dtype} and strides "
                    f"{array.strides}; it must have {numbers} float64 values per arm, stored in {layout.name.lower()}"
                )
        for table, (array, shape) in enumerate(zip(tables, program.tables, strict=True)):
            good = array.ndim > 0 and array.shape[1:] == shape[1:] and len(array) == (shape[0] or max(len(array), 1))
            if not (good and array.flags.c_contiguous and array.dtype == _DOUBLE):
                raise ValueError(
                    f"table {table} has shape {array.shape} and type {array.dtype}; needed: a contiguous float64 array "
                    f"with {shape[0] or 'one or more'} row(s) of shape {shape[1:]}"
                )
        lengths = [*(array.strides[0] // _SIZE for array in arrays), *map(len, tables)]
        return _Known(arrays, constants, tables, arms, lengths, self.code(arms))

    @functools.cached_property
    def _wide(self) -> int:
        """Number of arms in a vector; halved if a long program would not fit into the registers."""
        return EIGHT if self.program.size() > _LONG and not self.program.arrays else WIDE

    def code(self, arms: int) -> _Code:
        """Return the machine code for a number of arms."""
        width = 1 if arms < WIDE // 2 else self._wide
        code = self._codes.get(width)
        if code is None:
            text = kernel_text(self.program, self.layouts, width, repeated=self.repeated)
            code = self._codes[width] = _machine_code(text, width)
        return code


def _address(array: np.ndarray) -> int:
    try:  # three times as fast as below, but not for read-only arrays or arrays with gaps
        return ctypes.addressof(_BYTE.from_buffer(array))  # type: ignore[arg-type]
    except (BufferError, TypeError, ValueError):
        return int(array.__array_interface__["data"][0])


_BYTE = ctypes.c_char
_AXES, _DOUBLE, _SIZE = 2, np.dtype(np.float64), 8
_SPAN, _ADDRESS = struct.Struct("2q"), struct.Struct("q")  # first arm and last arm + 1


class _Code:
    """Machine code in memory: the engine that owns it, and its entry point."""

    def __init__(self, binary: bytes, machine: Any, width: int) -> None:
        self.engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self.engine.add_object_file(llvm.ObjectFileRef.from_data(binary))
        self.engine.finalize_object()
        address = self.engine.get_function_address("kernel")
        # One arm takes a microsecond, too short to let other threads run.
        kind = ctypes.CFUNCTYPE if width > 1 else ctypes.PYFUNCTYPE
        self.call = kind(None, ctypes.c_void_p)(address)


@functools.lru_cache(maxsize=512)
def _machine_code(text: str, width: int) -> _Code:
    """Return the machine code of an LLVM text for `width` arms at once, compiled unless the cache folder has it."""
    level = 1 if width > 1 else 2  # LLVM's optimisation level
    _initialise()
    processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    # A new machine each time, since an engine keeps it.
    machine = llvm.Target.from_default_triple().create_target_machine(cpu=processor, features=features, opt=level)
    version = ".".join(map(str, llvm.llvm_version_info))
    key = "\n".join([text, processor, features, str(level), version])
    path = _folder() / f"{hashlib.sha256(key.encode()).hexdigest()}.o"
    binary = _stored(path)
    if binary is None:
        message = "FuzzyArm: compiling machine code (takes seconds; the result is kept on disk) ..."
        with announced(message, after=_LASTING):
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
    """Return the machine code in a file; None if there is no file or its digest is wrong."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    size = hashlib.sha256().digest_size
    return content[size:] if hashlib.sha256(content[size:]).digest() == content[:size] else None


def _folder() -> Path:
    if named := os.environ.get(_CACHE):
        return Path(named)
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home) / "fuzzyarm"


@functools.cache
def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
