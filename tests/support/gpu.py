"""Where kernels in PTX run: the first NVIDIA GPU, or a driver that runs them on the processor, on its memory."""

import ctypes
import re
import types
from collections import Counter

import pytest

from fuzzyarm.numbers.gpu import Gpu, gpu
from support.ptx_machine import run_ptx


class PretendedDriver:
    """The functions of the CUDA driver that `Gpu` calls; the memory of its device is the processor's.

    Attributes:
        calls: how often each function was called.
        launched: the parameters of each launch, and its stream.
        failing: codes by the names of functions that fail.
    """

    def __init__(self):
        self.calls, self.launched, self.failing = Counter(), [], {}
        self._modules, self._current = [], []

    def __getattr__(self, name):
        own = getattr(type(self), f"_{name}")

        def called(*arguments):
            self.calls[name] += 1
            if name in self.failing:
                return self.failing[name]
            own(self, *arguments)
            return 0

        return called

    def _cuInit(self, flags):
        assert flags.value == 0

    def _cuDeviceGet(self, device, number):
        device._obj.value = 7 + number.value

    def _cuDeviceGetAttribute(self, value, which, device):
        assert device.value == 7
        value._obj.value = {75: 8, 76: 6}[which.value]

    def _cuDevicePrimaryCtxRetain(self, context, device):
        assert device.value == 7
        context._obj.value = 70

    def _cuCtxPushCurrent_v2(self, context):
        self._current.append(context.value)

    def _cuCtxPopCurrent_v2(self, context):
        context._obj.value = self._current.pop()

    def _cuModuleLoadData(self, module, text):
        assert self._current == [70]
        self._modules.append(text.value.decode())
        module._obj.value = len(self._modules)

    def _cuModuleGetFunction(self, function, module, name):
        assert f".entry {name.value.decode()}(" in self._modules[module.value - 1]
        function._obj.value = 100 + module.value

    def _cuLaunchKernel(self, function, *rest):
        assert self._current == [70]
        *grid, shared, stream, pointers, extra = rest
        (blocks, *others), text = [one.value for one in grid], self._modules[function.value - 101]
        assert others[:2] == others[3:] == [1, 1] and shared.value == 0 and not extra.value
        count = len(re.findall(r"\.param \.u64 ", text))
        assert len(pointers) == count and ".target sm_86" in text
        given = [ctypes.c_int64.from_address(place).value for place in pointers]
        self.launched.append((given, stream.value or 0))
        run_ptx(text, given, blocks, others[2])


def pretended_launcher(driver):
    """Return what launches kernels on tensors of the processor, by a pretended driver."""
    own = Gpu(0, driver)

    def shown(tensor):
        assert tensor.device.type == "cpu"
        return types.SimpleNamespace(__cuda_array_interface__=tensor.numpy().__array_interface__)

    def launch(kernel, arrays, constants, tables, steps):
        own.launch(kernel, [*map(shown, arrays)], shown(constants), [*map(shown, tables)], steps, 0)

    return launch


def by_machine_code(kernel, arrays, constants, tables, steps):
    """Run a kernel on tensors of the processor by machine code, in place of a launch."""
    kernel([one.numpy() for one in arrays], constants.numpy(), [one.numpy() for one in tables], steps)


def on_first_gpu(kernel, arrays, constants, tables, steps=1):
    """Run a kernel on copies of arrays on the first GPU; then they hold what it has found."""
    torch = pytest.importorskip("torch")
    there = [torch.tensor(one, device="cuda") for one in (*arrays, constants, *tables)]
    rest = there[len(arrays)], there[len(arrays) + 1 :]
    gpu(0).launch(kernel, there[: len(arrays)], *rest, steps, torch.cuda.current_stream().cuda_stream)
    for own, found in zip(arrays, there, strict=False):
        own[...] = found.cpu().numpy()


def needs_gpu():
    """Skip the test where torch has no GPU."""
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("no GPU that torch can use")
