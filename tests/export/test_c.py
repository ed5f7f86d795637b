"""Exported C: the same bits as the policy, no warning, and one line for what cannot be written."""

import csv
import ctypes
import dataclasses
import itertools
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from slow_twins import slow_but
from support.bundles import network
from support.exported import COMPILERS, answers, assert_same_bits, bits, needs_compiler

from fuzzyarm import ArmParameters, Robot, ScheduledSpecification, design_scheduled, export_c, load_policy
from fuzzyarm.cli import main
from fuzzyarm.cli._commands.show import loaded
from fuzzyarm.export._c_text import LAW, Recorded, Unsupported, _helper_text, _literal_of, program_of
from fuzzyarm.export.c_files import FLAGS
from fuzzyarm.export.c_files import _CompiledLaw as CompiledLaw
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.numbers.functions import apart, array, each, entry, number, only, repeat, row, select, when, word

ROOT = Path(__file__).parents[2]


SATURATED = [("fuzzy-4-tip", None), ("elastic-observer", None)]
LAWS = [
    *SATURATED,
    *((name, None) for name in ("ppo-nominal", "fuzzy-32", "computed-torque", "computed-torque-tip", "ppo-residual")),
    *(("learned-observer", None), ("adaptive-observer", None), ("computed-torque-tip", "planar-3r")),
    *(("elastic-observer", "ur5"), ("adaptive-observer", "ur5")),
    (ROOT / "benchmarks/estimates/planar-3r-0", "planar-3r"),
]


@needs_compiler
@pytest.mark.parametrize("compiler", slow_but(COMPILERS[:1], COMPILERS))
@pytest.mark.parametrize("law", slow_but(LAWS[:3], LAWS))
def test_the_compiled_law_gives_the_bits_of_the_policy(law, compiler, tmp_path):
    name, robot = law
    torque = assert_same_bits(load_policy(name, robot=robot), tmp_path, 20, 150, compiler)
    if law in SATURATED:  # the limits, and the integral held there, are part of it
        assert 0.05 < (np.abs(torque) == [500.0, 250.0]).mean() < 0.95


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("tip", ["", "-tip"])
def test_so_do_files_of_the_semidefinite_form(tip, tmp_path):
    robot = Robot.of(ArmParameters())
    design_scheduled(ScheduledSpecification(rules=2), robot).controller.save(tmp_path / "mine.json")
    assert_same_bits(loaded(f"{tmp_path / 'mine.json'}{tip}", None), tmp_path, 10, 200)


@needs_compiler
def test_the_vectors_of_float_are_answers_of_float(tmp_path, monkeypatch):
    policy = load_policy("fuzzy-1-tip")
    header, source, vectors = export_c("law", policy, tmp_path, "float")
    rows = np.loadtxt(vectors, delimiter=",", skiprows=1)[:, 1:]
    seen, torque = rows[:, :10], rows[:, 10:]
    np.testing.assert_array_equal(seen, seen.astype(np.float32))
    law = CompiledLaw(source, 2, policy.memory_size, "float", COMPILERS[-1])
    own, _ = law.run(seen[:, np.newaxis], np.arange(len(seen))[:, np.newaxis] == 0)
    np.testing.assert_array_equal(own[:, 0], torque)
    doubled, _ = answers(policy, seen[:, np.newaxis], np.arange(len(seen))[:, np.newaxis] == 0)
    assert np.abs(doubled[:, 0] - torque).max() > 1e-6
    monkeypatch.setattr("fuzzyarm.export.c_files.compilers", lambda: [])
    assert export_c("law", policy, tmp_path, "float") == [header, source]


def test_what_guards_a_division_guards_it_in_float():
    for least in (1e-300, -1e-300):
        assert float(_literal_of(least, "double").strip("()")) == least
        guard = np.float32(_literal_of(least, "float").strip("f()"))
        assert np.isfinite(np.float32(1.0) / guard) and np.sign(guard) == np.sign(least)
    assert _literal_of(0.0, "float") == "0.0f"


def compiled(source, *options):
    """Compile a file without a warning; return the object, or with -shared the library."""
    out = source.with_suffix(".so" if "-shared" in options else ".o")
    words = [COMPILERS[0], *FLAGS, *(options or ("-c",)), str(source), "-o", str(out)]
    assert subprocess.run(words, capture_output=True, text=True, check=False).stderr == ""
    return out


@needs_compiler
def test_the_lines_of_the_page_compile(tmp_path):
    export_c("fuzzy-4", load_policy("fuzzy-4"), tmp_path)
    page = (ROOT / "docs" / "controllers" / "export.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    (tmp_path / "board.c").write_text(lines, encoding="utf-8")
    compiled(tmp_path / "board.c")


@needs_compiler
def test_two_laws_go_into_one_file_and_their_headers_into_cpp(tmp_path):
    for name in ("elastic-observer", "fuzzy-1-tip"):
        export_c(name, load_policy(name), tmp_path)
    names = ("elastic_observer", "fuzzy_1_tip")
    (tmp_path / "both.c").write_text("".join(f'#include "{name}.c"\n' for name in names), encoding="utf-8")
    lines = [f'#include "{name}.h"\n' for name in names]
    calls = " ".join(f"{name}_state s{k}; {name}_init(&s{k});" for k, name in enumerate(names))
    (tmp_path / "main.cpp").write_text("".join([*lines, f"int main() {{ {calls} return 0; }}\n"]), encoding="utf-8")
    both = compiled(tmp_path / "both.c")
    if linker := shutil.which("g++") or shutil.which("clang++"):
        words = [linker, str(tmp_path / "main.cpp"), str(both), "-o", str(tmp_path / "main")]
        assert subprocess.run(words, capture_output=True, text=True, check=False).stderr == ""


@pytest.mark.parametrize(
    ("first", "second", "more"),
    [("arm left", "arm-left", {}), ("arm", "arm", {"name": "computed-torque"}), ("arm", "arm", {"number": "float"})],
)
def test_an_export_replaces_no_other_one(first, second, more, tmp_path):
    law = load_policy("fuzzy-1")
    files = export_c(first, law, tmp_path)
    before = [file.read_bytes() for file in files]
    with pytest.raises(ValueError, match=r"arm.*\.[hc] already exists with different content: remove it, or choose"):
        export_c(second, load_policy(more.get("name", "fuzzy-1")), tmp_path, more.get("number", "double"))
    assert export_c(first, law, tmp_path) == files
    assert [file.read_bytes() for file in files] == before and len(list(tmp_path.iterdir())) == len(files)


def test_the_vectors_are_the_answers_of_the_policy(tmp_path, capsys):
    assert main(["export", "c", "fuzzy-4", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.count("written to") == 3
    with (tmp_path / "fuzzy_4_vectors.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    policy, state = load_policy("fuzzy-4"), None
    for line in rows:
        numbers = [float(value) for value in line.values()]
        torque, state = policy.predict(np.array(numbers[1:11]), state)
        assert numbers[11:] == torque.tolist()
    header = (tmp_path / "fuzzy_4.h").read_text(encoding="utf-8")
    stated = " ".join(header.replace("\n *", " ").split())
    assert policy.controller.digest in stated and "alpha = 20 1/s" in stated and "Not covered: the elastic" in stated


def test_the_source_allocates_nothing_and_calls_no_library(tmp_path):
    _, source, _ = export_c("law", load_policy("elastic-observer"), tmp_path)
    text = source.read_text(encoding="utf-8")
    assert re.findall(r"#include (.*)", text) == ['"law.h"']
    called = set(re.findall(r"\b([a-z_]\w*)\(", text)) - {"if", "for", "while"}
    assert called == set(re.findall(r"^(?:static )?(?:double|int|void) (\w+)\(", text, re.MULTILINE))
    assert "while" not in text
    bounds = re.findall(r"\bfor \((?:int )?(\w+) = 0; \1 < (\w+); \1\+\+\) {", text)
    assert len(bounds) == text.count("for (") and all(bound.isdigit() for _, bound in bounds)


def branching(x, flag):
    y = array(2)
    y[0] = y[1] = x
    for _ in only(flag > 0.0):
        y[1] = -x
    kept = when(flag > 0.0, lambda: 2.0 * x, 1.0)
    return select(kept > x, y[0] + y[1], kept)


def looped(x, flag):
    """Carried numbers that change places, an array whose rounds depend on each other, and a branch in a loop."""
    first, second = repeat(3, lambda pair: (pair[1], pair[0] + x), (x, flag))
    sums = array(4)
    for j in each(4):
        sums[j] = x
    for j in each(3):
        for i in each(j + 1):
            sums[j + 1] = sums[j + 1] + sums[i] * number(2 * i + 1 - j)
        for _ in only(sums[j] > flag):
            sums[j + 1] = -sums[j]
    first = when(first > flag, lambda: repeat(2, lambda y: y * y, first), second)
    return first + sums[3] * np.rint(second) + entry(np.array([[1.0, -2.0], [0.5, 3.0]]), 0.0, 1)


@apart
def quotient(pair, γ, unused):
    return pair[0] / γ, (pair[1] > γ) * γ, 3.0


@apart
def constant(x):
    return 0.25


def called(x, flag):
    """Functions within functions, one in a loop, with results that nothing needs."""
    total = array(1)
    total[0] = x
    for k in each(3):
        first, second, third = quotient((x, total[0]), flag + (number(k) + 0.25), x)
        total[0] = first + third * constant(second)
    return total[0] + quotient((x, flag), 2.0, x)[1]


def tabled(x, flag, table):
    rest = ((x != flag) | (flag <= x)) * np.floor(x)
    return entry(table, x, 1) + row(table, flag)[0] * abs(x) - rest + -(1.0 * -flag)


TABLE = np.array([[1.0, -2.0], [0.5, 3.0], [1e300, 4.0]])
FUNCTIONS = [(branching, ()), (looped, ()), (called, ()), (tabled, (TABLE,))]


def recorded(function, tables=()):
    """The function of two numbers as a law without memory."""

    def step(given, memory, *tables):
        return memory, (function(*given, *tables),)

    return Recorded(step, (["x", "flag"], (0.0, 0.0)), (), 1, LAW, "own.law", tables)


@needs_compiler
@pytest.mark.parametrize(("function", "tables"), FUNCTIONS)
def test_branches_loops_and_tables_are_those_of_python(function, tables, tmp_path):
    program, state = recorded(function, tables), ctypes.create_string_buffer(4096)
    (tmp_path / "own.h").write_text(program.header_text("own", [], "double"), encoding="utf-8")
    (tmp_path / "own.c").write_text(program.source_text("own", "double"), encoding="utf-8")
    step = ctypes.CDLL(str(compiled(tmp_path / "own.c", "-shared", "-fPIC"))).own_step
    for x, flag in itertools.product((-2.0, -0.0, 0.5, 1.0, 1.5, 3.0, 1e6), (-1.0, 0.0, 1.0, 2.5)):
        torque = ctypes.c_double()
        assert step(state, (ctypes.c_double * 2)(x, flag), ctypes.byref(torque)) == 0
        assert bits(torque.value) == bits(function(x, flag, *tables)), (x, flag)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda x: np.arctan(x), "own.law needs a value that is known only at run time: .*arctan"),
        (
            lambda x: x if x > 0.0 else -x,
            "a compiled function cannot branch on a number that it computes; use select or",
        ),
        (lambda x: number(word(x)), "own.law computes 'word', an operation that cannot be written in C"),
        (lambda x: [1.0, 2.0][int(x)], "own.law needs a value that is known only at run time"),
    ],
)
def test_what_cannot_be_written_says_what(wrong, message):
    with pytest.raises(Unsupported, match=message):
        recorded(lambda x, _: wrong(x)).source_text("own", "double")


def test_a_policy_without_a_law_is_refused():
    class Own(ComputedTorquePolicy):
        def act(self, observation, memory, torque):
            torque[:] = 0.0

    with pytest.raises(Unsupported, match=r"Own has no law that can be exported; derive the class from .*\.LawPolicy"):
        program_of(Own())


@needs_compiler
@pytest.mark.parametrize(("real", "kind"), [("double", np.float64), ("float", np.float32)])
def test_the_square_root_is_rounded_correctly(real, kind, tmp_path):
    text = f"void all(long n, const {real} *x, {real} *y);\nvoid all(long n, const {real} *x, {real} *y)\n"
    text += "{\n    long k;\n    for (k = 0; k < n; k++) {\n        y[k] = sqrt_(x[k]);\n    }\n}\n"
    (tmp_path / "root.c").write_text(f"#include <float.h>\n{_helper_text('sqrt', real)}{text}", encoding="utf-8")
    library = ctypes.CDLL(str(compiled(tmp_path / "root.c", "-shared", "-fPIC")))
    rng, limits, bits = np.random.default_rng(0), np.finfo(kind), {"double": np.uint64, "float": np.uint32}[real]
    squares = rng.uniform(1.0, 2.0, 10_000).astype(kind) ** 2
    powers = kind(2.0) ** np.arange(np.log2(limits.smallest_subnormal), limits.maxexp).astype(kind)
    ends = np.array([0.0, -0.0, limits.max, limits.tiny, np.inf, -np.inf, np.nan, -1.0], dtype=kind)
    anything = rng.integers(0, np.iinfo(bits).max, 100_000, dtype=bits).view(kind)
    x = np.concatenate([squares, powers, ends, anything])
    with np.errstate(all="ignore"):
        x = np.concatenate([x, np.nextafter(x, kind(0.0)), np.nextafter(x, kind(np.inf))])
    y = np.empty_like(x)
    library.all(ctypes.c_long(len(x)), *(a.ctypes.data_as(ctypes.c_void_p) for a in (x, y)))
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(y, np.sqrt(x))


def test_a_network_that_is_too_large_is_one_line(tmp_path, capsys):
    bundle = load_policy("ppo-nominal").bundle
    large = network((bundle.network.sizes[0], 600, 600, 2))
    dataclasses.replace(bundle, network=large).save(tmp_path / "large")
    assert main(["export", "c", str(tmp_path / "large"), "--out", str(tmp_path / "new")]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and not (tmp_path / "new").exists()
    assert "numbers in its tables or layers; allowed: at most 262144" in err
