"""One text with every kind of number: floats, machine code of one arm and of many, its files, other processors."""

import itertools
import math
import os
import platform
import re
import subprocess
import sys

import llvmlite.binding as llvm
import numpy as np
import pytest

from fuzzyarm import ArmParameters, load_policy
from fuzzyarm.envs.batch._kernels import kernels_of
from fuzzyarm.envs.batch.layout import by_rows, in_blocks
from fuzzyarm.envs.physics.elementwise import gaussian, root, sign, sine_cosine
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.numbers import machine
from fuzzyarm.numbers._llvm_text import kernel_text
from fuzzyarm.numbers.functions import (
    Cells,
    array,
    bits,
    each,
    floor,
    maximum,
    minimum,
    number,
    only,
    repeat,
    row,
    select,
    when,
    whole,
    word,
)
from fuzzyarm.numbers.machine import WIDE, Kernel, PortLayout
from fuzzyarm.numbers.program import Program

TABLE = np.arange(15.0).reshape(5, 3) ** 2
SHARED = (0.75, 3.0)
GIVEN = np.array(SHARED), (TABLE,)
SPECIAL = [0.0, -0.0, 1.0, -1.5, math.nan, math.inf, -math.inf, 1e300, 5e-324, 2.5, 1e6, -7.25]


def text(x, seen, shared, table):
    """All that a recorded function may do, in an order that depends on the numbers."""
    a, (b, c) = x
    low, steps = shared
    sine, cosine = sine_cosine(minimum(maximum(b, -100.0), 100.0))
    inside = (b > low) & ~((c <= -1.0) | (b == c))
    grown = repeat(steps, lambda pair: (pair[0] + 1.0, 0.5 * pair[1] + a * pair[0]), (0.0, b))
    looked = row(table, a)
    rare = when(b > 2.0, lambda: (a / b, sine - c), (b, c))
    known, other = select(sine == sine, abs(sine), 0.5), select(cosine == cosine, abs(cosine), 0.5)
    key = word(c) ^ (whole(floor(9.0 * known)) * 5 >> 1)
    gathered = select(inside, sine * cosine - grown[1], gaussian(b) + looked[2] * -c)
    return (gathered, rare), (looked[0] + sign(a), root(abs(c)), bits(key), number(whole(other * 8.0) >> 1))


def recorded(layouts=(), repeated=False):
    return Kernel(Program(text, ((0.0, (0.0, 0.0)), (0.0,) * 4), SHARED, [(0, 3)]), layouts, repeated=repeated)


def same(a, b):
    """Equal bits, but for the sign and content of what is not a number."""
    return np.array_equal(a, b, equal_nan=True) and np.array_equal(np.signbit(a[a == a]), np.signbit(b[b == b]))


def numbers(arms, seed=0):
    x = np.random.default_rng(seed).normal(size=(arms, 3)) * [3.0, 4.0, 2.0]
    x[: len(SPECIAL), 1] = SPECIAL[:arms]
    x[-len(SPECIAL) :, 2] = SPECIAL[-arms:][::-1]
    return x


@pytest.fixture(params=["short", "long"])
def length(request, monkeypatch):
    """Whether a program counts as long, and its arms go in smaller groups."""
    monkeypatch.setattr(machine, "_LONG", 0 if request.param == "long" else 10**6)


@pytest.mark.usefixtures("length")
@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning", "ignore:invalid:RuntimeWarning")
@pytest.mark.parametrize("arms", [1, 7, WIDE, WIDE + 1, 100])
def test_machine_code_of_any_number_of_arms_has_the_bits_of_floats(arms):
    given = numbers(arms), np.zeros((arms, 4))
    with np.errstate(all="ignore"):
        wanted = [np.hstack(flat(text((a, (b, c)), (0.0,) * 4, SHARED, TABLE.tolist()))) for a, b, c in given[0]]
    recorded()(given, *GIVEN)
    assert same(np.hstack(given), np.array(wanted))


@pytest.mark.usefixtures("length")
@pytest.mark.parametrize("arms", [1, 2 * WIDE + 3])
def test_layouts_change_no_bit_and_no_neighbour(arms):
    x, seen = numbers(arms, seed=1), np.zeros((arms, 4))
    rows, block, wide, apart = x.copy(), in_blocks(x.T), np.full((4, arms + 5), 7.0), np.full((arms, 9), 7.0)
    apart[:, :3] = x
    recorded()((rows, seen), *GIVEN)
    recorded([PortLayout.BLOCKS, PortLayout.COLUMNS])((block, wide[:, :arms]), *GIVEN)
    recorded()((apart[:, :3], apart[:, 4:8]), *GIVEN)
    assert same(by_rows(block, arms).T, rows)
    assert same(wide[:, :arms], seen.T) and (wide[:, arms:] == 7.0).all()
    assert same(apart[:, :3], rows) and same(apart[:, 4:8], seen) and (apart[:, [3, 8]] == 7.0).all()


@pytest.mark.usefixtures("length")
@pytest.mark.parametrize("arms", [3, 70])
def test_steps_of_one_call_are_calls_of_one_step_and_parts_of_the_arms_the_whole(arms):
    once, often, in_parts = (numbers(arms, seed=2) for _ in range(3))
    seen, last, other = (np.zeros((arms, 4)) for _ in range(3))
    call, kernel = recorded().bound((in_parts, other), *GIVEN), recorded()
    for _ in range(5):
        kernel((once, seen), *GIVEN)
        for part in [(48, arms), (0, 16), (16, 48)] if arms > 48 else [(0, arms)]:
            call.part(*part)
    recorded(repeated=True)((often, last), *GIVEN, steps=5)
    assert same(often, once) and same(last, seen) and same(in_parts, once) and same(other, seen)


@pytest.mark.parametrize(("place", "found"), [(-3.0, 0), (0.99, 0), (3.0, 3), (4.2, 4), (1e300, 4), (math.nan, 0)])
@pytest.mark.parametrize("arms", [1, WIDE])
def test_no_place_is_outside_of_a_table(place, found, arms):
    kernel = Kernel(Program(lambda x, _, table: (row(table, x[0]),), ((0.0,) * 3,), (), [(5, 3)]))
    x = np.full((arms, 3), place)
    kernel((x,), np.empty(0), (TABLE,))
    assert (x == TABLE[found]).all() and row(TABLE.tolist(), place) == tuple(TABLE[found])


def test_what_is_known_is_recorded_once_and_outside_of_loops():
    def function(x, shared):
        product = repeat(9.0, lambda carried: (carried[0] + x[0] * x[1],), (x[0],))
        return ((product[0], x[0] * x[1] / (shared[0] / 3.0)),)

    program = Program(function, ((0.0, 0.0),), (1.0,))
    assert program.size() == 4  # x0 x1 before the loop, the sum in it, what is of constants alone, and the quotient


@pytest.mark.parametrize("wrong", [lambda x: x + 1.0 if x > 0.0 else x, lambda x: max(x, 0.0), lambda x: [x][int(x)]])
def test_what_cannot_be_recorded_is_refused(wrong):
    with pytest.raises(TypeError, match=r"select or when|int\(\)"):
        Program(lambda x, _: ((wrong(x[0]),),), ((0.0,),))
    with pytest.raises(ValueError, match=r"returns outputs of sizes \(1,\); the sizes must be \(1, 2\)"):
        Program(lambda x, y, _: (x,), ((0.0,), (0.0, 0.0)))


def test_arrays_that_do_not_fit_are_refused():
    kernel, (three, four) = recorded(), (np.zeros((4, 3)), np.zeros((4, 4)))
    kernel((three, four), *GIVEN)
    for arrays, table, message in (
        ((np.zeros((4, 3), np.float32), four), TABLE, "float32"),
        ((np.zeros((4, 2)), four), TABLE, r"shape \(4, 2\)"),
        ((three, np.zeros((5, 4))), TABLE, r"array 1 \(for 4 arms\) has shape \(5, 4\)"),
        ((np.zeros((4, 6))[:, ::2], four), TABLE, "strides"),
        ((three,), TABLE, r"1 array\(s\) and 1 table\(s\) were given; the program takes 2 and 1"),
        ((three, four), np.zeros((0, 3)), "table 0 has shape"),
        ((three, four), np.zeros((2, 4)), "table 0 has shape"),
        ((three, four), np.zeros((2, 3), np.float32), "table 0 has shape"),
        ((three, four), np.zeros((4, 6))[::2, ::2], "table 0 has shape"),
    ):
        with pytest.raises(ValueError, match=message):
            kernel(arrays, np.array(SHARED), (table,))


N = 5
WEIGHTS = np.random.default_rng(4).normal(size=(N, N, 2))


def cholesky(memory, x, _, weights):
    """The factor of a positive matrix, a loop in a loop, sums, and what only some arms do."""
    (P, count), (a, b) = memory, x
    L, total = array(N, N), array(1)
    for i in each(N):
        for j in each(N):
            P[i, j] += 0.5 * a * weights[i, j, 0]
    for i in each(N):
        for j in each(i):
            total[0] = P[i, j]
            for k in each(j):
                total[0] -= L[i, k] * L[j, k]
            L[i, j] = total[0] / L[j, j]
        total[0] = P[i, i]
        for k in each(i):
            total[0] -= L[i, k] * L[i, k]
        L[i, i] = root(maximum(total[0], 1e-3))
    for _ in only(b > 0.0):
        for i in each(N):
            P[i, N - 1 - i] = L[N - 1, i] * weights[2, 1, 1]
            for _ in only(P[i, i] > a):
                P[i, i] = -b
    return (P, count + 1.0), (L[N - 1, N - 1], b)


@pytest.mark.parametrize("arms", [1, WIDE + 5])
def test_loops_over_arrays_have_the_bits_of_python(arms):
    generator = np.random.default_rng(arms)
    x, memory = generator.normal(size=(arms, 2)), np.zeros((arms, N * N + 1))
    memory[:, :-1] = (10.0 * np.eye(N) + generator.normal(size=(arms, N, N))).reshape(arms, N * N)
    wanted = memory.copy(), x.copy()
    for own, seen in zip(*wanted, strict=True):
        for _ in range(3):
            (_, own[-1]), seen[:] = cholesky((own[:-1].reshape(N, N), own[-1]), tuple(seen), (), WEIGHTS)
    kernel = Kernel(Program(cholesky, ((Cells((N, N)), 0.0), (0.0, 0.0)), (), [WEIGHTS.shape]))
    for _ in range(3):
        kernel((memory, x), np.empty(0), (WEIGHTS,))
    assert np.array_equal(memory, wanted[0]) and np.array_equal(x, wanted[1])
    assert kernel.program.size() < 60  # a loop is recorded once


def test_a_number_of_a_loop_is_known_in_it_alone():
    def leaks(x, _):
        for k in each(3):
            last = x[0] * (x[1] if k is None else 2.0) + array(1)[0]
        return ((last, last),)

    with pytest.raises(TypeError, match="store it in an array"):
        Program(leaks, ((0.0, 0.0),))


PROGRAM = """
import sys
import numpy as np
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program
x = np.array([[3.0]])
Kernel(Program(lambda x, _: ((x[0] / 7.0,),), ((0.0,),)))((x,), np.empty(0))
assert x[0, 0] == 3.0 / 7.0
"""


def run(folder, program=PROGRAM, word="", count=1):
    """Run processes together that keep machine code in a folder; return what they print."""
    words, environment = [sys.executable, "-c", program, word], os.environ | {machine._CACHE: str(folder)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    together = [subprocess.Popen(words, env=environment, text=True, **pipes) for _ in range(count)]
    said = [one.communicate(timeout=300) for one in together]
    assert not any(one.returncode for one in together), said
    return "".join(out for out, _ in said)


def test_a_file_that_is_damaged_or_foreign_is_made_again(tmp_path):
    run(tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    good = file.read_bytes()
    changed = good[:-100] + bytes([good[-100] ^ 1]) + good[-99:]
    for damaged in (good[:50], changed, b"\x7fELF" + bytes(2000)):
        file.write_bytes(damaged)
        run(tmp_path / "cache")
        assert list(file.parent.iterdir()) == [file] and file.read_bytes() == good
    (tmp_path / "file").write_text("not a folder")
    run(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "not a folder"


@pytest.mark.slow
def test_processes_that_start_together_leave_one_whole_file(tmp_path):
    run(tmp_path, count=6)
    (file,) = tmp_path.iterdir()
    good = file.read_bytes()
    run(tmp_path)
    assert file.read_bytes() == good


def test_a_processor_and_a_text_have_their_own_files(tmp_path, monkeypatch):
    monkeypatch.setenv(machine._CACHE, str(tmp_path))
    program, here = Program(lambda x, _: ((x[0] + 1.0,),), ((0.0,),)), machine.llvm.get_host_cpu_name()
    for processor, arms, files in ((here, 1, 1), (here, 20, 2), ("x86-64", 1, 3)):
        monkeypatch.setattr(machine.llvm, "get_host_cpu_name", lambda name=processor: name)
        machine._machine_code.cache_clear()
        Kernel(program)((np.zeros((arms, 1)),), np.empty(0))
        assert len(list(tmp_path.iterdir())) == files
    machine._machine_code.cache_clear()


FUSED = re.compile(r"\b(vfn?m(add|sub)|fn?m(add|sub|la|ls)\b)", re.I)
PROCESSORS = {"x86-64-v3": "x86_64-unknown-linux-gnu", "generic": "aarch64-unknown-linux-gnu"}

SIMULATION = """
import hashlib, itertools, sys
import llvmlite.binding as llvm
import numpy as np

class Plain:
    def flatten(self):
        return ""

if sys.argv[1]:
    llvm.get_host_cpu_name, llvm.get_host_cpu_features = lambda: sys.argv[1], Plain
import gymnasium as gym
import fuzzyarm
from fuzzyarm.eval.episodes.loop import episodes

envs = gym.make_vec("FuzzyArm-v0", num_envs=40, randomisation="plants", case="machining")
found = hashlib.sha256()
policy = fuzzyarm.load_policy("elastic-observer")
for step in itertools.islice(episodes(envs, policy, envs.reset(seed=0)), 300):
    for array in (step.observation, step.reward, step.info["tip"], step.info["torque"], step.memory):
        found.update(np.ascontiguousarray(array).tobytes())
print(found.hexdigest())
"""


def assembly(text, processor, triple):
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(triple).create_target_machine(cpu=processor, opt=3)
    module = llvm.parse_assembly(text)
    module.triple = triple
    builder = llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options(speed_level=3))
    builder.getModulePassManager().run(module, builder)
    return target.emit_assembly(module)


@pytest.mark.slow
@pytest.mark.parametrize("processor", PROCESSORS)
def test_no_multiplication_is_fused_with_an_addition(processor):
    """In a control step and in a law, of one arm and of many."""
    kernels = (kernels_of(equations_of(ArmParameters())).step, load_policy("elastic-observer")._command_kernel)
    for one, width in itertools.product(kernels, (1, WIDE)):
        text = kernel_text(one.program, one.layouts, width)
        assert not FUSED.search(assembly(text, processor, PROCESSORS[processor]))
    free = re.sub(r"\b(fmul|fadd|fsub) ", r"\1 contract ", text)
    assert FUSED.search(assembly(free, processor, PROCESSORS[processor]))  # which is what LLVM does where it may


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="runs the machine code of x86-64 processors")
def test_an_old_processor_gives_the_same_bits(tmp_path):
    digest, files = run(tmp_path, SIMULATION), len(list(tmp_path.iterdir()))  # of this one with all it has
    assert run(tmp_path, SIMULATION, "x86-64") == digest and len(digest) == 65  # one of 2003
    assert len(list(tmp_path.iterdir())) == 2 * files  # each has its own machine code
