"""Programs as PTX: structure, meaning on the host and on a GPU if there is one, and what an assembler makes of it."""

import ctypes
import math
import re
import shutil
import struct
import subprocess
import sysconfig
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from support.gpu import first_gpu
from support.ptx_machine import run_ptx
from test_machine import SHARED, TABLE, WEIGHTS, N, cholesky, numbers, recorded, same

from fuzzyarm import load_policy, policies
from fuzzyarm.envs.batch.kernels import Kernels, kernels_of
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import errors_in_one_kernel
from fuzzyarm.eval.sweep.plants import Plants
from fuzzyarm.numbers import llvm_operations, machine, ptx
from fuzzyarm.numbers.functions import Cells
from fuzzyarm.numbers.machine import WIDE, Kernel, Layout
from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.ptx import gpu_text, logarithm, ptx_of
from fuzzyarm.numbers.symbols import Symbol

LANES = 40


def in_columns(array, layout, arms):
    """Return a copy of the numbers of a port as (numbers, arms)."""
    if layout is Layout.BLOCKS:
        array = array.swapaxes(1, 2).reshape(-1, array.shape[1])[:arms]
    return (array if layout is Layout.COLUMNS else array.T).copy()


def on_host(kernel, arrays, constants, tables, steps=1, threads=7):
    """Run the text of a GPU's kernel thread by thread on this processor: arrays (numbers, arms) change in place."""
    text, parameters = gpu_text(kernel)
    for old, new in {
        "ptx_kernel ": "",
        "(i64 %stop": "(i64 %thread, i64 %of, i64 %stop",
        "call i64 @thread()": "add i64 %thread, 0",
        "call i64 @threads()": "add i64 %of, 0",
    }.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    places = [one.ctypes.data for one in (*arrays, constants, *tables)]
    given = [arrays[0].shape[1], steps, *places, *(one.strides[0] // 8 for one in arrays), *map(len, tables)]
    assert len(given) == len(parameters)
    code = machine._machine_code(text, 1)
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * (2 + len(given)))(code.engine.get_function_address("kernel"))
    for thread in range(threads):
        call(thread, threads, *given)


def on_ptx_machine(kernel, arrays, constants, tables, steps=1):
    """Run a kernel's PTX on `ptx_machine`, on four blocks of three threads; arrays (numbers, arms) change in place."""
    places = [one.ctypes.data for one in (*arrays, constants, *tables)]
    given = [arrays[0].shape[1], steps, *places, *(one.strides[0] // 8 for one in arrays), *map(len, tables)]
    run_ptx(ptx_of(kernel).text, given, blocks=4, threads=3)


def has_the_bits(kernel, arrays, constants, tables, steps=1, *, expected=None, runs=(on_host, on_ptx_machine)):
    """Return whether a GPU's text gives the bits of machine code, from arrays (numbers, arms)."""
    program = (expected or kernel).program
    known, wanted = Kernel(program, [Layout.COLUMNS] * len(arrays), repeated=kernel.repeated), copied(arrays)
    known(wanted, constants, tables, steps)
    assert any(not np.array_equal(a, b, equal_nan=True) for a, b in zip(arrays, wanted, strict=True))
    for run in runs:
        found = copied(arrays)
        run(kernel, found, constants, tables, steps)
        if not all(same(a, b) for a, b in zip(wanted, found, strict=True)):
            return False
    return True


def copied(arrays):
    return [one.copy() for one in arrays]


def used_by(function, monkeypatch):
    """Return each kernel that a function runs, with copies in columns of what it runs on.

    The copies are of the beginning where a kernel takes all steps of an episode, and else of the end.
    """
    calls, checked = {}, Kernel._checked

    def noted(kernel, arrays, constants, tables):
        known = checked(kernel, arrays, constants, tables)
        arrays = [one.copy() for one in arrays] if kernel.repeated else arrays
        calls[id(kernel)] = kernel, arrays, constants, tables, known.arms
        return known

    with monkeypatch.context() as patched:
        patched.setattr(Kernel, "_checked", noted)
        function()
    return [
        (kernel, [in_columns(*pair, arms) for pair in zip(arrays, kernel.layouts, strict=True)], constants, tables)
        for kernel, arrays, constants, tables, arms in calls.values()
    ]


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


# --- structure ----------------------------------------------------------------------------------------------------


def test_a_kernel_has_its_parameters_and_rounds_after_each_operation():
    written = ptx_of(recorded(), "named")
    assert written.name == "named" and ".visible .entry named(" in written.text and ".target sm_90" in written.text
    assert written.parameters == ("stop", "steps", "port0", "port1", "c", "table0", "stride0", "stride1", "rows0")
    assert len(re.findall(r"\.param \.u64 ", written.text)) == len(written.parameters)
    assert all(f"%{one}.x" in written.text for one in ("tid", "ntid", "ctaid", "nctaid"))
    operations = re.findall(r"\b(?:add|sub|mul)(\S*)\.f64", written.text)
    assert len(operations) > 20 and set(operations) == {".rn"} and "fma" not in written.text
    assert ".extern" not in written.text and "approx" not in written.text


def test_an_operation_without_an_instruction_is_refused(monkeypatch):
    monkeypatch.setitem(llvm_operations.CALLED, "cosine", "cos")
    kernel = Kernel(Program(lambda x, _: ((x[0].program.operation("cosine", x[0]),),), ((0.0,),)))
    with pytest.raises(ValueError, match="cosine has no instruction in PTX"):
        ptx_of(kernel)


def test_what_an_assembler_may_fuse_is_refused(monkeypatch):
    whole = Kernel(Program(lambda x, _: ((x[0] * x[1] + x[0], x[1]),), ((0.0, 0.0),)))
    free = gpu_text(whole)[0].replace("fadd", "fadd contract").replace("fmul", "fmul contract")
    ptx_of(whole)
    monkeypatch.setattr(ptx, "gpu_text", lambda *_: (free, ()))
    with pytest.raises(RuntimeError, match="does not round twice"):
        ptx_of(whole)


# --- meaning ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [0, 3])
@pytest.mark.parametrize("arms", [1, 6, 7, 100])
def test_the_text_has_the_bits_of_machine_code(arms, steps):
    arrays = [numbers(arms).T.copy(), np.zeros((4, arms))]
    assert has_the_bits(recorded(repeated=steps > 0), arrays, np.array(SHARED), (TABLE,), max(steps, 1))


def test_rows_may_lie_apart_and_neighbours_stay():
    wide = np.full((3, 64), 7.0)
    wide[:, :LANES] = numbers(LANES).T
    wanted, seen = wide[:, :LANES].T.copy(), np.zeros((4, LANES))
    recorded()((wanted, np.zeros((LANES, 4))), np.array(SHARED), (TABLE,))
    on_host(recorded(), (wide[:, :LANES], seen), np.array(SHARED), (TABLE,), threads=64)  # more threads than arms
    assert same(wide[:, :LANES], wanted.T) and (wide[:, LANES:] == 7.0).all()


def test_arrays_have_the_bits_of_machine_code():
    generator = np.random.default_rng(1)
    memory = np.vstack([generator.normal(size=(N * N, 9)), np.zeros((1, 9))])
    memory[: N * N : N + 1] += 10.0
    kernel = Kernel(Program(cholesky, ((Cells((N, N)), 0.0), (0.0, 0.0)), (), [WEIGHTS.shape]))
    assert has_the_bits(kernel, [memory, generator.normal(size=(2, 9))], np.empty(0), (WEIGHTS,))


def test_the_logarithm():
    x = np.exp(np.random.default_rng(0).uniform(-745.0, 709.0, size=10_000))
    x[:5000] = np.random.default_rng(1).uniform(0.5, 2.0, size=5000)
    x[:10] = [0.0, -0.0, -1.0, -math.inf, math.inf, math.nan, 5e-324, 2.0**-1022, 1.0, np.finfo(float).max]
    direct, called = x.copy()[np.newaxis], x.copy()[np.newaxis]
    Kernel(Program(lambda x, _: ((logarithm(x[0]),),), ((0.0,),)), [Layout.COLUMNS])((direct,), np.empty(0))
    on_host(Kernel(Program(lambda x, _: ((x[0].log(),),), ((0.0,),))), (called,), np.empty(0), ())
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


# --- an assembler -------------------------------------------------------------------------------------------------


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
    text = ptx_of(Kernel(Program(lambda x, _: ((x[0] * x[1] + x[0], x[1]),), ((0.0, 0.0),)))).text
    free = re.sub(r"\b(add|mul)\.rn\.f64", r"\1.f64", text)
    assert assembled(text, tmp_path, fused=True) == assembled(text, tmp_path, fused=False)
    assert assembled(free, tmp_path, fused=True) != assembled(free, tmp_path, fused=False)


def swept():
    """Run closed loops of two laws with plants, delays and noise."""
    for name in ("fuzzy-4", "elastic-observer"):
        config = SweepConfig(plants=WIDE, policies=(name,))
        plants = Plants.draw(config, range(WIDE))
        assert errors_in_one_kernel(plants, plants.environment(config.cases[:1]), load_policy(name)) is not None


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
    gpu = first_gpu()
    for kernel, given, expected in kernels_in(what, monkeypatch):
        assert has_the_bits(kernel, *given, expected=expected, runs=(gpu.run,))
