"""One text with every kind of number: floats, machine code of one arm and of many, and where that is kept."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from fuzzyarm.envs.batch.layout import by_rows, in_blocks
from fuzzyarm.envs.physics.elementwise import gaussian, root, sign, sine_cosine
from fuzzyarm.numbers import machine
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


def expected(x, shared=SHARED):
    after, seen = text((x[0], (x[1], x[2])), (0.0,) * 4, shared, TABLE.tolist())
    return np.array([after[0], *after[1]]), np.array(seen)


def recorded(layouts=(), repeated=False):
    return Kernel(Program(text, ((0.0, (0.0, 0.0)), (0.0,) * 4), SHARED, [(0, 3)]), layouts, repeated=repeated)


def same(a, b):
    """Equal bits, but for the sign and content of what is not a number."""
    return np.array_equal(a, b, equal_nan=True) and np.array_equal(np.signbit(a[a == a]), np.signbit(b[b == b]))


def numbers(arms, seed=0):
    generator = np.random.default_rng(seed)
    x = generator.normal(size=(arms, 3)) * [3.0, 4.0, 2.0]
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
    x = numbers(arms)
    with np.errstate(all="ignore"):
        wanted = [expected([np.float64(n) for n in one]) for one in x]
    given = x.copy(), np.zeros((arms, 4))
    recorded()(given, np.array(SHARED), (TABLE,))
    assert all(same(found, np.array(column)) for found, column in zip(given, zip(*wanted, strict=True), strict=True))


@pytest.mark.usefixtures("length")
@pytest.mark.parametrize("arms", [1, 2 * WIDE + 3])
def test_layouts_change_no_bit_and_no_neighbour(arms):
    x, seen = numbers(arms, seed=1), np.zeros((arms, 4))
    rows, block = x.copy(), in_blocks(x.T)
    recorded()((rows, seen), np.array(SHARED), (TABLE,))
    wide = np.full((4, arms + 5), 7.0)
    recorded([PortLayout.BLOCKS, PortLayout.COLUMNS])((block, wide[:, :arms]), np.array(SHARED), (TABLE,))
    assert same(by_rows(block, arms).T, rows)
    assert same(wide[:, :arms], seen.T) and (wide[:, arms:] == 7.0).all()
    apart = np.full((arms, 9), 7.0)
    apart[:, :3] = x
    recorded()((apart[:, :3], apart[:, 4:8]), np.array(SHARED), (TABLE,))
    assert same(apart[:, :3], rows) and same(apart[:, 4:8], seen) and (apart[:, [3, 8]] == 7.0).all()


@pytest.mark.usefixtures("length")
@pytest.mark.parametrize("arms", [3, 70])
def test_steps_of_one_call_are_calls_of_one_step_and_parts_of_the_arms_the_whole(arms):
    once, often, in_parts = (numbers(arms, seed=2) for _ in range(3))
    seen, last, other = (np.zeros((arms, 4)) for _ in range(3))
    call = recorded().bound((in_parts, other), np.array(SHARED), (TABLE,))
    for _ in range(5):
        recorded()((once, seen), np.array(SHARED), (TABLE,))
        for part in [(48, arms), (0, 16), (16, 48)] if arms > 48 else [(0, arms)]:
            call.part(*part)
    recorded(repeated=True)((often, last), np.array(SHARED), (TABLE,), steps=5)
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


FITTING = np.zeros((4, 3)), np.zeros((4, 4))


@pytest.mark.parametrize(
    ("arrays", "table", "message"),
    [
        ((np.zeros((4, 3), np.float32), FITTING[1]), TABLE, "float32"),
        ((np.zeros((4, 2)), FITTING[1]), TABLE, r"shape \(4, 2\)"),
        ((FITTING[0], np.zeros((5, 4))), TABLE, r"array 1 \(for 4 arms\) has shape \(5, 4\)"),
        ((np.zeros((4, 6))[:, ::2], FITTING[1]), TABLE, "strides"),
        (FITTING[:1], TABLE, r"1 array\(s\) and 1 table\(s\) were given; the program takes 2 and 1"),
        (FITTING, np.zeros((0, 3)), "table 0 has shape"),
        (FITTING, np.zeros((2, 4)), "table 0 has shape"),
        (FITTING, np.zeros((2, 3), np.float32), "table 0 has shape"),
        (FITTING, np.zeros((4, 6))[::2, ::2], "table 0 has shape"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(arrays, table, message):
    kernel = recorded()
    kernel(FITTING, np.array(SHARED), (TABLE,))
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
    generator, size = np.random.default_rng(arms), N * N
    memory, x = np.empty((arms, size + 1)), generator.normal(size=(arms, 2))
    memory[:, :size] = (10.0 * np.eye(N) + generator.normal(size=(arms, N, N))).reshape(arms, size)
    memory[:, size] = 0.0
    wanted, found = [], []
    for own, seen in zip(memory.copy(), x.copy(), strict=True):
        P, state = own[:size].reshape(N, N), (0.0, tuple(seen))
        for _ in range(3):
            (_, count), state = cholesky((P, state[0]), state[1], (), WEIGHTS)
            state = count, state
        wanted.append([*P.ravel(), state[0]])
        found.append(state[1])
    kernel = Kernel(Program(cholesky, ((Cells((N, N)), 0.0), (0.0, 0.0)), (), [WEIGHTS.shape]))
    for _ in range(3):
        kernel((memory, x), np.empty(0), (WEIGHTS,))
    assert np.array_equal(memory, wanted) and np.array_equal(x, found)
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


def run(folder, count=1):
    words, options = [sys.executable, "-c", PROGRAM], {"env": os.environ | {machine._CACHE: str(folder)}}
    together = [subprocess.Popen(words, **options, stderr=subprocess.PIPE) for _ in range(count)]
    for one in together:
        _, error = one.communicate(timeout=120)
        assert one.returncode == 0, error.decode()


def test_a_file_that_is_damaged_or_foreign_is_made_again(tmp_path):
    run(tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    good = file.read_bytes()
    changed = bytearray(good)
    changed[-100] ^= 1
    for damaged in (good[:50], bytes(changed), b"\x7fELF" + bytes(2000)):
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
    machine._machine_code.cache_clear()
    one = Kernel(Program(lambda x, _: ((x[0] + 1.0,),), ((0.0,),)))
    one((np.zeros((1, 1)),), np.empty(0))
    one((np.zeros((20, 1)),), np.empty(0))
    assert len(list(tmp_path.iterdir())) == 2  # of one arm, and of many
    monkeypatch.setattr(machine.llvm, "get_host_cpu_name", lambda: "x86-64")
    machine._machine_code.cache_clear()
    Kernel(one.program)((np.zeros((1, 1)),), np.empty(0))
    assert len(list(tmp_path.iterdir())) == 3
    machine._machine_code.cache_clear()
