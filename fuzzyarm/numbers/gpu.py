"""Kernels on an NVIDIA GPU, launched by its driver on arrays that lie there; nothing is copied.

The tests replace the driver by one that runs PTX on the processor. No GPU has run this module.
"""

from __future__ import annotations

import ctypes
import functools
import types
from collections.abc import Sequence
from typing import Any

import numpy as np

from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.ptx import ptx_of

__all__ = ["Gpu", "gpu"]

_MAJOR, _MINOR = 75, 76  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_...
_NEWEST = 90  # what the tests assemble for; later processors run it, too
_BLOCK = 64  # threads; one may need 255 of a processor's 65,536 registers


class Gpu:
    """A GPU in its primary context, which torch uses, too.

    Args:
        number: of the GPU, as torch counts them.
        driver: the library `libcuda.so.1`, loaded by `ctypes`.

    Attributes:
        processor: what kernels are written for, as LLVM names it.

    Raises:
        RuntimeError: a function of the driver fails; the message names it and its code.
    """

    def __init__(self, number: int, driver: Any) -> None:
        """Hold the context."""
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
        """Begin to run a kernel for every arm, `steps` times; this does not wait for its end.

        Args:
            kernel: it becomes a module of the GPU at its first launch.
            arrays: as for `Kernel.bound`, objects with `__cuda_array_interface__`, such as tensors of torch. Whoever
                calls keeps them and what follows alive until the stream has come to the end.
            constants: likewise.
            tables: likewise.
            steps: at least 1.
            stream: the handle of a stream of this GPU.

        Raises:
            ValueError: an array has another shape, type or layout.
            RuntimeError: a function of the driver fails; the message names it and its code.
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
    """Return a GPU by its number, always the same.

    Raises:
        RuntimeError: there is no driver, or one of its functions fails; the message names it and its code.
    """
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError as error:
        raise RuntimeError(f"no NVIDIA driver: {error}") from None
    return Gpu(number, driver)
