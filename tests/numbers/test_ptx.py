"""Programs as PTX: structure, meaning on the host and on a GPU if there is one, and what an assembler makes of it."""

import ctypes
import math
import re
import shutil
import struct
import subprocess
import sysconfig
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from support.gpu import PretendedDriver, by_machine_code, needs_gpu, on_first_gpu
from support.ptx_machine import run_ptx
from test_machine import SHARED, TABLE, WEIGHTS, N, cholesky, numbers, recorded, same

from fuzzyarm import load_policy, policies
from fuzzyarm.envs.batch.kernels import Kernels, kernels_of
from fuzzyarm.envs.batch.layout import in_blocks
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import errors_in_one_kernel
from fuzzyarm.eval.sweep.plants import Plants
from fuzzyarm.numbers import gpu, llvm_text, machine
from fuzzyarm.numbers.functions import Cells
from fuzzyarm.numbers.gpu import Gpu, _gpu_text, logarithm, ptx_of
from fuzzyarm.numbers.machine import WIDE, Kernel, Layout
from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.symbols import Symbol

LANES = 40


def in_columns(array, layout, arms):
    """Return a copy of the numbers of a port as (numbers, arms)."""
    if layout is Layout.BLOCKS:
        array = array.swapaxes(1, 2).reshape(-1, array.shape[1])[:arms]
    return (array if layout is Layout.COLUMNS else array.T).copy()


def laid_out(array, layout):
    """Return the numbers of arms (arms, numbers) as a port has them."""
    columns = array.T.copy()
    return {Layout.ROWS: array, Layout.COLUMNS: columns, Layout.BLOCKS: in_blocks(columns)}[layout]


def given_to(kernel, arrays, constants, tables, steps):
    """Return the parameters of a kernel in PTX."""
    arms, lengths = kernel.shapes(arrays, constants, tables)
    return [arms, steps, *(one.ctypes.data for one in (*arrays, constants, *tables)), *lengths]


def on_host(kernel, arrays, constants, tables, steps=1, threads=7):
    """Run the text of a GPU's kernel thread by thread on this processor: arrays change in place."""
    text, parameters = _gpu_text(kernel)
    for old, new in {
        "ptx_kernel ": "",
        "(i64 %stop": "(i64 %thread, i64 %of, i64 %stop",
        "call i64 @thread()": "add i64 %thread, 0",
        "call i64 @threads()": "add i64 %of, 0",
    }.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    given = given_to(kernel, arrays, constants, tables, steps)
    assert len(given) == len(parameters)
    code = machine._machine_code(text, 1)
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * (2 + len(given)))(code.engine.get_function_address("kernel"))
    for thread in range(threads):
        call(thread, threads, *given)


def on_ptx_machine(kernel, arrays, constants, tables, steps=1):
    """Run a kernel's PTX on `ptx_machine`, on four blocks of three threads; arrays change in place."""
    run_ptx(ptx_of(kernel).text, given_to(kernel, arrays, constants, tables, steps), blocks=4, threads=3)


def has_the_bits(kernel, arrays, constants, tables, steps=1, *, expected=None, runs=(on_host, on_ptx_machine)):
    """Return whether a GPU's text gives the bits of machine code."""
    known, wanted = expected or kernel, copied(arrays)
    arms, _ = kernel.shapes(arrays, constants, tables)
    known(wanted, constants, tables, steps)
    assert any(not np.array_equal(a, b, equal_nan=True) for a, b in zip(arrays, wanted, strict=True))
    for run in runs:
        found = copied(arrays)
        run(kernel, found, constants, tables, steps)
        pairs = zip(wanted, found, kernel.layouts, strict=True)
        if not all(same(in_columns(a, layout, arms), in_columns(b, layout, arms)) for a, b, layout in pairs):
            return False
    return True


def copied(arrays):
    return [one.copy() for one in arrays]


def used_by(function, monkeypatch):
    """Return each kernel that a function runs, with copies of what it runs on.

    The copies are of the beginning where a kernel takes all steps of an episode, and else of the end.
    """
    calls, checked = {}, Kernel._checked

    def noted(kernel, arrays, constants, tables):
        known = checked(kernel, arrays, constants, tables)
        arrays = [one.copy() for one in arrays] if kernel.repeated else arrays
        calls[id(kernel)] = kernel, arrays, constants, tables
        return known

    with monkeypatch.context() as patched:
        patched.setattr(Kernel, "_checked", noted)
        function()
    return [(kernel, copied(arrays), *rest) for kernel, arrays, *rest in calls.values()]


def stepped(case="machining", **options):
    """Run a batch of arms for a while."""
    kernels_of.cache_clear()
    envs = gym.make_vec("FuzzyArm-v0", num_envs=LANES, case=case, **options)
    envs.reset(seed=0)
    for torque in np.random.default_rng(0).normal(size=(20, *envs.action_space.shape)):
        envs.step(torque)


def with_own_logarithm(physics, monkeypatch):
    """Return an environment's kernels in which the logarithm is that of GPUs."""
    own = Kernels(physics)
    with monkeypatch.context() as patched:
        patched.setattr(Symbol, "log", logarithm)
        return {own.step.program.ports: own.step, own.begin.program.ports: own.begin}


def test_a_kernel_has_its_parameters_and_rounds_after_each_operation():
    written = ptx_of(recorded(), "named")
    assert written.name == "named" and ".visible .entry named(" in written.text and ".target sm_90" in written.text
    assert written.parameters == ("stop", "steps", "port0", "port1", "c", "table0", "stride0", "stride1", "rows0")
    assert len(re.findall(r"\.param \.u64 ", written.text)) == len(written.parameters)
    assert all(f"%{one}.x" in written.text for one in ("tid", "ntid", "ctaid", "nctaid"))
    operations = re.findall(r"\b(?:add|sub|mul)(\S*)\.f64", written.text)
    assert len(operations) > 20 and set(operations) == {".rn"} and "fma" not in written.text
    assert ".extern" not in written.text and "approx" not in written.text


FUSED = Kernel(Program(lambda x, _: ((x[0] * x[1] + x[0], x[1]),), ((0.0, 0.0),)))


def test_what_an_assembler_may_fuse_or_has_no_instruction_for_is_refused(monkeypatch):
    free = _gpu_text(FUSED)[0].replace("fadd", "fadd contract").replace("fmul", "fmul contract")
    ptx_of(FUSED)
    monkeypatch.setattr(gpu, "_gpu_text", lambda *_: (free, ()))
    with pytest.raises(RuntimeError, match="does not round twice"):
        ptx_of(FUSED)
    monkeypatch.undo()
    monkeypatch.setitem(llvm_text.CALLED, "cosine", "cos")
    kernel = Kernel(Program(lambda x, _: ((x[0].program.operation("cosine", x[0]),),), ((0.0,),)))
    with pytest.raises(ValueError, match="cosine has no instruction in PTX"):
        ptx_of(kernel)


@pytest.mark.parametrize("steps", [0, 3])
@pytest.mark.parametrize("arms", [1, 7, 100])
@pytest.mark.parametrize("layout", Layout)
def test_the_text_has_the_bits_of_machine_code(layout, arms, steps):
    kernel = recorded([layout, Layout.ROWS], repeated=steps > 0)
    arrays = [laid_out(numbers(arms), layout), np.zeros((arms, 4))]
    assert has_the_bits(kernel, arrays, np.array(SHARED), (TABLE,), max(steps, 1))


def test_arrays_have_the_bits_of_machine_code():
    generator = np.random.default_rng(1)
    memory = np.hstack([generator.normal(size=(9, N * N)), np.zeros((9, 1))])
    memory[:, : N * N : N + 1] += 10.0
    program = Program(cholesky, ((Cells((N, N)), 0.0), (0.0, 0.0)), (), [WEIGHTS.shape])
    for layout in Layout:
        arrays = [laid_out(memory, layout), generator.normal(size=(9, 2))]
        assert has_the_bits(Kernel(program, [layout, Layout.ROWS]), arrays, np.empty(0), (WEIGHTS,))


def test_the_logarithm():
    x = np.exp(np.random.default_rng(0).uniform(-745.0, 709.0, size=10_000))
    x[:5000] = np.random.default_rng(1).uniform(0.5, 2.0, size=5000)
    x[:10] = [0.0, -0.0, -1.0, -math.inf, math.inf, math.nan, 5e-324, 2.0**-1022, 1.0, np.finfo(float).max]
    direct, called = x.copy()[np.newaxis], x.copy()[np.newaxis]
    Kernel(Program(lambda x, _: ((logarithm(x[0]),),), ((0.0,),)), [Layout.COLUMNS])((direct,), np.empty(0))
    on_host(Kernel(Program(lambda x, _: ((x[0].log(),),), ((0.0,),)), [Layout.COLUMNS]), (called,), np.empty(0), ())
    assert same(direct, called)
    with np.errstate(all="ignore"):
        exact = np.log(x.astype(np.longdouble))
    finite, found = np.isfinite(exact), called[0]
    assert np.array_equal(found[~finite], exact[~finite].astype(float), equal_nan=True) and finite.sum() == len(x) - 6
    found, exact = found[finite], exact[finite]
    assert (np.abs(found - exact) <= np.spacing(np.abs(found))).all()


def test_an_environment_has_the_bits_of_machine_code(monkeypatch):
    own = with_own_logarithm(equations_of(ArmParameters()), monkeypatch)
    used = used_by(lambda: stepped(randomisation="robust"), monkeypatch)
    assert {kernel.program.ports for kernel, *_ in used} == set(own)
    for kernel, *given in used:
        assert has_the_bits(kernel, *given, expected=own[kernel.program.ports])


def there(array):
    """Return an array as one of the pretended driver's device."""
    return SimpleNamespace(__cuda_array_interface__=array.__array_interface__)


def launched(own, kernel, arrays, constants, tables, steps=1):
    own.launch(kernel, [*map(there, arrays)], there(constants), [*map(there, tables)], steps, 5)


def test_a_launch_is_on_the_arrays_themselves_in_the_stream_of_the_caller():
    driver, kernel = PretendedDriver(), recorded([Layout.BLOCKS, Layout.COLUMNS], repeated=True)
    own = Gpu(0, driver)

    def run(*given):
        launched(own, *given)

    arrays = [laid_out(numbers(100), Layout.BLOCKS), np.zeros((4, 100))]
    for _ in range(2):
        assert has_the_bits(kernel, arrays, np.array(SHARED), (TABLE,), 3, runs=(run,))
    launched(own, kernel, arrays, np.array(SHARED), (TABLE,))
    given, stream = driver.launched[-1]
    assert given[:4] == [100, 1, *(one.ctypes.data for one in arrays)] and stream == 5
    assert driver.calls["cuModuleLoadData"] == 1 and driver.calls["cuLaunchKernel"] == 3
    assert driver.calls["cuCtxPopCurrent_v2"] == 3 and own.processor == "sm_86"


@pytest.mark.parametrize(("name", "code"), [("cuModuleLoadData", 218), ("cuLaunchKernel", 700)])
def test_an_error_of_the_driver_has_its_name_and_code(name, code):
    driver, given = PretendedDriver(), (recorded(), [numbers(2), np.zeros((2, 4))], np.array(SHARED), (TABLE,))
    own, driver.failing = Gpu(0, driver), {name: code}
    with pytest.raises(RuntimeError, match=f"driver's {name} failed with code {code}"):
        launched(own, *given)
    driver.failing = {}
    launched(own, *given)  # the context of the thread is what it was
    with pytest.raises(ValueError, match="array 1 of 2 arms has shape"):
        launched(own, recorded(), [numbers(2), np.zeros((3, 4))], *given[2:])
    driver.failing = {"cuInit": 100}
    with pytest.raises(RuntimeError, match="cuInit failed with code 100"):
        Gpu(0, driver)


def assembler():
    """Return where `ptxas` is, of the path or of the wheel nvidia-cuda-nvcc-cu12; skip the test without one."""
    wheel = Path(sysconfig.get_path("purelib"), "nvidia", "cuda_nvcc", "bin", "ptxas")
    found = shutil.which("ptxas") or shutil.which(wheel)
    if found is None:
        pytest.skip("no ptxas, neither on the path nor of the wheel nvidia-cuda-nvcc-cu12")
    return found


def sections(cubin):
    """Return the sections of an ELF file by name."""
    (at,), (size, count, names) = struct.unpack_from("<Q", cubin, 0x28), struct.unpack_from("<3H", cubin, 0x3A)
    rows = [struct.unpack_from("<2I4Q", cubin, at + size * k) for k in range(count)]
    names = cubin[rows[names][4] :]
    return {names[row[0] : names.index(b"\0", row[0])].decode(): cubin[row[4] : row[4] + row[5]] for row in rows}


def assembled(text, folder, *, fused):
    """Return what the assembler makes of the kernel for sm_90, where it may fuse and where it may not."""
    source, out = folder / "kernel.ptx", folder / "kernel.cubin"
    source.write_text(text)
    arguments = [assembler(), "-arch=sm_90", "-O3", f"--fmad={str(fused).lower()}", source, "-o", out]
    answer = subprocess.run(arguments, capture_output=True, text=True, timeout=300)
    assert answer.returncode == 0, answer.stderr
    return sections(out.read_bytes())[".text.kernel"]


@pytest.mark.slow
def test_an_assembler_fuses_where_it_may(tmp_path):
    text = ptx_of(FUSED).text
    free = re.sub(r"\b(add|mul)\.rn\.f64", r"\1.f64", text)
    assert assembled(text, tmp_path, fused=True) == assembled(text, tmp_path, fused=False)
    assert assembled(free, tmp_path, fused=True) != assembled(free, tmp_path, fused=False)


def swept():
    """Run closed loops of two laws with plants, delays and noise."""
    for name in ("fuzzy-4", "elastic-observer"):
        config = SweepConfig(plants=WIDE, policies=(name,))
        plants = Plants(config, range(WIDE), config.cases[:1])
        assert errors_in_one_kernel(plants, load_policy(name)) is not None


def in_tensors(**options):
    """Step tensors, and run two laws in a kernel, by machine code in place of a GPU."""
    torch_env = pytest.importorskip("fuzzyarm.rl_baselines.torch_env")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(torch_env, "launcher", lambda device: by_machine_code)
        envs = torch_env.TorchFuzzyArm(LANES, dtype=torch_env.torch.float64, **options)
    envs.reset(seed=0)
    envs.step(np.zeros(envs.single_action_space.shape)[np.newaxis].repeat(LANES, axis=0))
    for name in ("fuzzy-4", "elastic-observer") if not options.get("robot") else ():
        envs.run(load_policy(name), 100)


def predicted(name):
    """Run a policy for three steps of many arms."""
    policy, state = load_policy(name), None
    for observation in np.random.default_rng(0).normal(size=(3, LANES, 10)) * 0.3:
        _, state = policy.predict(observation, state)


USED = {
    "two joints": lambda: stepped(randomisation="robust"),
    "load": lambda: stepped(case="payload", randomisation="plants"),
    "ur5": lambda: stepped(robot="ur5"),
    "closed loops": swept,
    "tensors": lambda: in_tensors(randomisation="robust"),
    "tensors of ur5": lambda: in_tensors(robot="ur5"),
    **{name: lambda name=name: predicted(name) for name in policies.registry.NAMES},
}


def kernels_in(what, monkeypatch):
    """Return kernels, what they are given, steps included, and the kernels that give the same, or None."""
    used = used_by(USED[what], monkeypatch)
    assert used
    arms = {"two joints": ArmParameters(), "load": ArmParameters(), "ur5": robot_named("ur5")}
    own = with_own_logarithm(equations_of(arms[what]), monkeypatch) if what in arms else {}
    return [(kernel, (*given, 100 if kernel.repeated else 1), own.get(kernel.program.ports)) for kernel, *given in used]


@pytest.mark.slow
@pytest.mark.parametrize("what", USED)
def test_kernels_of_the_package_have_the_bits_of_machine_code(what, monkeypatch):
    for kernel, given, expected in kernels_in(what, monkeypatch):
        assert has_the_bits(kernel, *given, expected=expected)


@pytest.mark.slow
@pytest.mark.parametrize("what", USED)
def test_kernels_of_the_package_are_assembled_and_nothing_is_fused(what, tmp_path, monkeypatch):
    assembler()
    for kernel, *_ in kernels_in(what, monkeypatch):
        text = ptx_of(kernel).text
        assert assembled(text, tmp_path, fused=True) == assembled(text, tmp_path, fused=False)


@pytest.mark.slow
@pytest.mark.parametrize("what", USED)
def test_a_gpu_has_the_bits_of_machine_code(what, monkeypatch):
    needs_gpu()
    for kernel, given, expected in kernels_in(what, monkeypatch):
        assert has_the_bits(kernel, *given, expected=expected, runs=(on_first_gpu,))
