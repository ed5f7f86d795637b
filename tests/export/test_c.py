"""Exported C: the same bits as the policy, no warning, and one line for what cannot be written."""

import csv
import ctypes
import itertools
import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.cli.show import loaded
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.export.c_files import FLAGS, CompiledLaw, c_name, compilers, export_c, random_observations
from fuzzyarm.export.c_text import LAW, Recorded, Unsupported, literal_of, program_of, source_text
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.numbers.functions import apart, array, each, entry, number, only, repeat, row, select, when, word
from fuzzyarm.synthesis import ScheduledSpecification, design_scheduled

COMPILERS = compilers()
needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler (gcc, clang) on this machine")
LIMIT = np.array([500.0, 250.0])


def observations(policy, lanes, calls):
    seen = np.stack([random_observations(policy, calls, seed) for seed in range(lanes)], axis=1)
    starts = np.zeros(seen.shape[:2], dtype=bool)
    starts[0] = starts[calls // 3, ::2] = True
    return seen, starts


def answers(policy, seen, starts):
    """What the policy itself answers: torques (calls, lanes, n) and the last memories."""
    torques, state = [], None
    for observation, start in zip(seen, starts, strict=True):
        torque, state = policy.predict(observation, state, start)
        torques.append(torque)
    return np.array(torques), state


def bits(array):
    return np.asarray(array, dtype=np.float64).view(np.int64)


def compiled(policy, folder, number="double", compiler=None):
    _, source, _ = export_c("law", policy, folder, number)
    return CompiledLaw(source, policy.joints, policy.memory_size, number, compiler or COMPILERS[0])


@needs_compiler
@pytest.mark.parametrize("name", ["fuzzy-4-tip", "elastic-observer"])
def test_the_compiled_law_gives_the_bits_of_the_policy(name, tmp_path):
    policy = load_policy(name)
    seen, starts = observations(policy, 20, 150)
    torque, memory = answers(policy, seen, starts)
    own_torque, own_memory = compiled(policy, tmp_path).run(seen, starts)
    np.testing.assert_array_equal(bits(own_torque), bits(torque))
    np.testing.assert_array_equal(bits(own_memory), bits(memory))
    at_limit = (np.abs(torque) == LIMIT).mean()
    assert 0.05 < at_limit < 0.95  # the limits, and the integral held there, are part of it


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS or ["none"])
@pytest.mark.parametrize("name", ["fuzzy-32", "fuzzy-1", "computed-torque", "fuzzy-16-tip", "computed-torque-tip"])
def test_so_do_the_other_laws_and_compilers(name, compiler, tmp_path):
    policy = load_policy(name)
    seen, starts = observations(policy, 50, 400)
    torque, memory = answers(policy, seen, starts)
    own_torque, own_memory = compiled(policy, tmp_path, compiler=compiler).run(seen, starts)
    np.testing.assert_array_equal(bits(own_torque), bits(torque))
    np.testing.assert_array_equal(bits(own_memory), bits(memory))


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("robot", ["planar-3r", "ur5"])
@pytest.mark.parametrize("name", ["computed-torque-tip", "elastic-observer", "adaptive-observer"])
def test_so_do_the_laws_of_other_robots(name, robot, tmp_path):
    policy = load_policy(name, robot=robot)
    seen, starts = observations(policy, 10, 200)
    torque, memory = answers(policy, seen, starts)
    own_torque, own_memory = compiled(policy, tmp_path).run(seen, starts)
    np.testing.assert_array_equal(bits(own_torque), bits(torque))
    # A filter diverges here, and IEEE 754 leaves the sign open of what is no number.
    np.testing.assert_array_equal(np.isnan(own_memory), np.isnan(memory))
    known = ~np.isnan(memory)
    np.testing.assert_array_equal(bits(own_memory)[known], bits(memory)[known])


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("tip", ["", "-tip"])
def test_so_do_files_of_the_semidefinite_form(tip, tmp_path):
    robot = Robot.of(ArmParameters())
    design_scheduled(ScheduledSpecification(rules=2), robot).controller.save(tmp_path / "mine.json")
    policy = loaded(f"{tmp_path / 'mine.json'}{tip}", None)
    seen, starts = observations(policy, 10, 200)
    torque, memory = answers(policy, seen, starts)
    own_torque, own_memory = compiled(policy, tmp_path).run(seen, starts)
    np.testing.assert_array_equal(bits(own_torque), bits(torque))
    np.testing.assert_array_equal(bits(own_memory), bits(memory))


@needs_compiler
@pytest.mark.slow
def test_in_float_the_torques_are_near(tmp_path):
    policy = load_policy("fuzzy-4")
    seen, starts = observations(policy, 20, 200)
    torque, _ = answers(policy, seen.astype(np.float32), starts)
    own, _ = compiled(policy, tmp_path, "float").run(seen, starts)
    assert 1e-6 < np.abs(own - torque).max() < 1.0


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


@pytest.mark.parametrize("name", ["adaptive-observer", "learned-observer"])
def test_a_law_that_float_ruins_is_refused_in_it(name, tmp_path, capsys):
    assert main(["export", "c", name, "--number", "float", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert f"{name} needs double" in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_what_guards_a_division_guards_it_in_float():
    for least in (1e-300, -1e-300):
        assert float(literal_of(least, "double").strip("()")) == least
        guard = np.float32(literal_of(least, "float").strip("f()"))
        assert np.isfinite(np.float32(1.0) / guard) and np.sign(guard) == np.sign(least)
    assert literal_of(0.0, "float") == "0.0f"


@needs_compiler
def test_the_lines_of_the_page_compile(tmp_path):
    export_c("fuzzy-4", load_policy("fuzzy-4"), tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "controllers" / "export.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    (tmp_path / "board.c").write_text(lines, encoding="utf-8")
    words = [COMPILERS[0], *FLAGS, "-c", str(tmp_path / "board.c"), "-o", str(tmp_path / "board.o")]
    assert subprocess.run(words, capture_output=True, text=True, check=False).stderr == ""


@needs_compiler
def test_two_laws_go_into_one_file_and_their_headers_into_cpp(tmp_path):
    for name in ("elastic-observer", "fuzzy-1-tip"):
        export_c(name, load_policy(name), tmp_path)
    names = ("elastic_observer", "fuzzy_1_tip")
    (tmp_path / "both.c").write_text("".join(f'#include "{name}.c"\n' for name in names), encoding="utf-8")
    lines = [f'#include "{name}.h"\n' for name in names]
    calls = " ".join(f"{name}_state s{k}; {name}_init(&s{k});" for k, name in enumerate(names))
    (tmp_path / "main.cpp").write_text("".join([*lines, f"int main() {{ {calls} return 0; }}\n"]), encoding="utf-8")
    words = [COMPILERS[0], *FLAGS, "-c", str(tmp_path / "both.c"), "-o", str(tmp_path / "both.o")]
    assert subprocess.run(words, capture_output=True, text=True, check=False).stderr == ""
    if linker := shutil.which("g++") or shutil.which("clang++"):
        words = [linker, str(tmp_path / "main.cpp"), str(tmp_path / "both.o"), "-o", str(tmp_path / "main")]
        assert subprocess.run(words, capture_output=True, text=True, check=False).stderr == ""


@pytest.mark.parametrize(
    ("first", "second", "more"),
    [("arm left", "arm-left", {}), ("arm", "arm", {"name": "computed-torque"}), ("arm", "arm", {"number": "float"})],
)
def test_an_export_replaces_no_other_one(first, second, more, tmp_path):
    law = load_policy("fuzzy-1")
    files = export_c(first, law, tmp_path)
    before = [file.read_bytes() for file in files]
    other = load_policy(more.get("name", "fuzzy-1"))
    with pytest.raises(ValueError, match=r"arm.*\.[hc] holds something else of the same name: remove it, or choose"):
        export_c(second, other, tmp_path, more.get("number", "double"))
    assert export_c(first, law, tmp_path) == files
    assert [file.read_bytes() for file in files] == before and len(list(tmp_path.iterdir())) == len(files)


@needs_compiler
def test_a_bit_that_differs_is_seen(tmp_path):
    """A gain that is changed in its last digit changes bits: the comparison above can fail."""
    policy = load_policy("fuzzy-1")
    _, source, _ = export_c("law", policy, tmp_path)
    text = source.read_text(encoding="utf-8")
    number = max(re.findall(r"\d+\.\d{6,}", text), key=float)
    source.write_text(text.replace(number, repr(math.nextafter(float(number), 0.0))), encoding="utf-8")
    changed = CompiledLaw(source, policy.joints, policy.memory_size, "double", COMPILERS[0])
    seen, starts = observations(policy, 5, 50)
    torque, _ = answers(policy, seen, starts)
    assert (bits(changed.run(seen, starts)[0]) != bits(torque)).any()


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
    return entry(table, x, 1) + row(table, flag)[0] * abs(x) - (x != flag) * np.floor(x) + -(1.0 * -flag)


def machine(function, tables):
    """The function as the C of this machine: numbers (2,) to a number."""
    names = ["x", "flag"]
    return Recorded(
        lambda given, memory, *tables: (memory, (function(*given, *tables),)),
        (names, (0.0, 0.0)),
        (),
        1,
        LAW,
        "own.law",
        tables,
    )


@needs_compiler
@pytest.mark.parametrize(
    ("function", "tables"),
    [
        (branching, ()),
        (looped, ()),
        (called, ()),
        (tabled, (np.array([[1.0, -2.0], [0.5, 3.0], [1e300, 4.0]]),)),
    ],
)
def test_branches_loops_and_tables_are_those_of_python(function, tables, tmp_path):
    (tmp_path / "own.h").write_text("typedef struct { double memory[1]; } own_state;\n", encoding="utf-8")
    (tmp_path / "own.c").write_text(source_text(machine(function, tables), "own", "double"), encoding="utf-8")
    library = tmp_path / "own.so"
    words = [COMPILERS[0], *FLAGS, "-shared", "-fPIC", str(tmp_path / "own.c"), "-o", str(library)]
    subprocess.run(words, check=True, capture_output=True)
    step = ctypes.CDLL(str(library)).own_step
    for x, flag in itertools.product((-2.0, -0.0, 0.5, 1.0, 1.5, 3.0, 1e6), (-1.0, 0.0, 1.0, 2.5)):
        torque = ctypes.c_double()
        step(None, (ctypes.c_double * 2)(x, flag), ctypes.byref(torque))
        assert bits(torque.value) == bits(function(x, flag, *tables)), (x, flag)


def test_what_nothing_needs_is_left_out():
    def step(given, memory):
        (x,), unused, kept = given, array(2), array(2)
        for k in each(2):
            unused[k] = x * 2.0
            kept[k] = x + 1.0
        return memory, (kept[1],)

    text = source_text(Recorded(step, (["x"], (0.0,)), (), 1, LAW, "own.law"), "own", "double")
    assert "x + 1.0" in text and "2.0" not in text.replace("array1[2]", "") and "array0" not in text


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda x: np.arctan(x), "own.law does something with a number that is not known: .*arctan"),
        (lambda x: x if x > 0.0 else -x, "a branch on a number that is not known while it is recorded; use select or"),
        (lambda x: number(word(x)), "own.law computes a word, which has no C function here"),
        (lambda x: [1.0, 2.0][int(x)], "own.law does something with a number that is not known"),
    ],
)
def test_what_cannot_be_written_says_what(wrong, message):
    with pytest.raises(Unsupported, match=message):
        source_text(machine(lambda x, _: wrong(x), ()), "own", "double")


def test_a_policy_without_a_law_is_refused():
    class Own(ComputedTorquePolicy):
        def act(self, observation, memory, torque):
            torque[:] = 0.0

    with pytest.raises(Unsupported, match="Own has no law that can be written as C; make it a `LawPolicy`"):
        program_of(Own())


@pytest.mark.parametrize(("label", "name"), [("fuzzy-4-tip", "fuzzy_4_tip"), ("2nd try", "law_2nd_try"), ("ä", "law")])
def test_names_in_c(label, name):
    assert c_name(label) == name


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["java", "fuzzy-4", "--out", "OUT"], "java is no language of an export; choose from: c"),
        (["c", "fuzzy-4"], "--out is missing"),
        (["c", "fuzzy-4", "--out", "OUT", "--number", "half"], 'invalid value "half" for --number'),
        (["c", "fuzzy-9", "--out", "OUT"], "unknown policy 'fuzzy-9'"),
    ],
)
def test_bad_usage_is_one_line(words, message, tmp_path, capsys):
    assert main(["export", *(word.replace("OUT", str(tmp_path / "new")) for word in words)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and message in err and err.count("\n") == 1
    assert not (tmp_path / "new").exists()
