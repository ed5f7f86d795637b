"""The first NVIDIA GPU, by its driver: runs a kernel in PTX on copies of arrays."""

import ctypes
from collections.abc import Sequence

import numpy as np
import pytest

from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.ptx import ptx_of

_MAJOR, _MINOR = 75, 76  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_...
_NEWEST = 90  # what the tests assemble for; later processors run it, too
_BLOCK = 64  # threads; one may need 255 of a processor's 65,536 registers


class Gpu:
    """A GPU in its primary context.

    Args:
        driver: the library `libcuda.so.1`.
    """

    def __init__(self, driver):
        self.driver = driver
        device, context, capability = ctypes.c_int(), ctypes.c_void_p(), (ctypes.c_int(), ctypes.c_int())
        self("cuInit", ctypes.c_uint(0))
        self("cuDeviceGet", ctypes.byref(device), ctypes.c_int(0))
        for number, which in zip(capability, (_MAJOR, _MINOR), strict=True):
            self("cuDeviceGetAttribute", ctypes.byref(number), ctypes.c_int(which), device)
        self.processor = f"sm_{min(10 * capability[0].value + capability[1].value, _NEWEST)}"
        self("cuDevicePrimaryCtxRetain", ctypes.byref(context), device)
        self("cuCtxSetCurrent", context)

    def __call__(self, name, *arguments):
        """Call a function of the driver, and raise RuntimeError where it fails."""
        if result := getattr(self.driver, name)(*arguments):
            raise RuntimeError(f"{name} failed with {result}")

    def run(
        self,
        kernel: Kernel,
        arrays: Sequence[np.ndarray],
        constants: np.ndarray,
        tables: Sequence[np.ndarray],
        steps: int = 1,
    ) -> None:
        """Run a kernel on arrays (numbers, arms), which change in place."""
        written, module, function = ptx_of(kernel, processor=self.processor), ctypes.c_void_p(), ctypes.c_void_p()
        self("cuModuleLoadData", ctypes.byref(module), ctypes.c_char_p(written.text.encode()))
        self("cuModuleGetFunction", ctypes.byref(function), module, ctypes.c_char_p(written.name.encode()))
        held, places, arms = (*arrays, constants, *tables), [], arrays[0].shape[1]
        for one in held:
            places.append(ctypes.c_uint64())
            self("cuMemAlloc_v2", ctypes.byref(places[-1]), ctypes.c_size_t(max(one.nbytes, 8)))
            self("cuMemcpyHtoD_v2", places[-1], _address(one), ctypes.c_size_t(one.nbytes))
        apart = [ctypes.c_int64(k) for k in (*(one.strides[0] // 8 for one in arrays), *map(len, tables))]
        given = [ctypes.c_int64(arms), ctypes.c_int64(steps), *places, *apart]
        assert len(given) == len(written.parameters)
        pointers = (ctypes.c_void_p * len(given))(*(ctypes.addressof(one) for one in given))
        grid = [ctypes.c_uint(k) for k in (-(-arms // _BLOCK), 1, 1, _BLOCK, 1, 1, 0)]
        self("cuLaunchKernel", function, *grid, ctypes.c_void_p(), pointers, ctypes.c_void_p())
        self("cuCtxSynchronize")
        for place, one in zip(places, held, strict=True):
            if any(one is array for array in arrays):
                self("cuMemcpyDtoH_v2", _address(one), place, ctypes.c_size_t(one.nbytes))
            self("cuMemFree_v2", place)
        self("cuModuleUnload", module)


def _address(array):
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


def first_gpu() -> Gpu:
    """Return the first GPU; skip the test without one."""
    try:
        return Gpu(ctypes.CDLL("libcuda.so.1"))
    except (OSError, RuntimeError) as error:
        pytest.skip(f"no NVIDIA GPU: {error}")
