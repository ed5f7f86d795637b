"""Exported C of policies that learn or identify: their bits, layers as loops over tables, their own square root."""

import ctypes
import dataclasses
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.export.c_files import FLAGS, CompiledLaw, compilers, export_c, random_observations, sources_of
from fuzzyarm.export.c_text import helper_text
from fuzzyarm.fuzzy_policy.laws.learned.network import Network

COMPILERS = compilers()
needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler (gcc, clang) on this machine")


def differing(policy, folder, compiler, lanes, calls):
    """How many bits of torques and of memories differ between C and Python."""
    _, source, _ = export_c("law", policy, folder)
    seen = np.stack([random_observations(policy, calls, seed) for seed in range(lanes)], axis=1)
    starts = np.zeros(seen.shape[:2], dtype=bool)
    starts[0] = starts[calls // 3, ::2] = True
    torques, state = [], None
    for observation, start in zip(seen, starts, strict=True):
        torque, state = policy.predict(observation, state, start)
        torques.append(torque)
    own, memory = CompiledLaw(source, policy.joints, policy.memory_size, "double", compiler).run(seen, starts)
    pairs = (own, np.array(torques)), (memory, state)
    return sum(np.count_nonzero(one.view(np.int64) != other.view(np.int64)) for one, other in pairs)


@needs_compiler
def test_a_learned_policy_gives_the_bits_of_its_python(tmp_path):
    assert differing(load_policy("ppo-nominal"), tmp_path, COMPILERS[0], 10, 100) == 0


def test_a_law_with_another_law_behind_it_has_its_text():
    """What the law behind remembers is nested, and comes back so from its limits."""
    policy = load_policy("adaptive-observer")
    texts = "".join(sources_of("law", policy, "double").values())
    assert f"memory[{policy.memory_size - 1}]" in texts


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS or ["none"])
@pytest.mark.parametrize("name", ["ppo-robust", "ppo-residual", "learned-observer", "adaptive-observer"])
def test_so_do_the_others(name, compiler, tmp_path):
    assert differing(load_policy(name), tmp_path, compiler, 20, 300) == 0


@needs_compiler
@pytest.mark.slow
def test_so_does_a_learned_estimate_of_three_joints(tmp_path):
    policy = load_policy(Path(__file__).parents[2] / "benchmarks/estimates/planar-3r-0", robot="planar-3r")
    assert differing(policy, tmp_path, COMPILERS[0], 4, 60) == 0


@needs_compiler
@pytest.mark.parametrize(("real", "kind"), [("double", np.float64), ("float", np.float32)])
def test_the_square_root_is_rounded_correctly(real, kind, tmp_path):
    text = f"void all(long n, const {real} *x, {real} *y);\nvoid all(long n, const {real} *x, {real} *y)\n"
    text += "{\n    long k;\n    for (k = 0; k < n; k++) {\n        y[k] = sqrt_(x[k]);\n    }\n}\n"
    own = helper_text("sqrt", real)
    (tmp_path / "root.c").write_text(f"#include <float.h>\n{own}{text}", encoding="utf-8")
    library = tmp_path / "root.so"
    words = [COMPILERS[0], *FLAGS, "-shared", "-fPIC", str(tmp_path / "root.c"), "-o", str(library)]
    subprocess.run(words, check=True, capture_output=True)
    rng, limits, bits = np.random.default_rng(0), np.finfo(kind), {"double": np.uint64, "float": np.uint32}[real]
    squares = rng.uniform(1.0, 2.0, 10_000).astype(kind) ** 2
    powers = kind(2.0) ** np.arange(np.log2(limits.smallest_subnormal), limits.maxexp).astype(kind)
    ends = np.array([0.0, -0.0, limits.max, limits.tiny, np.inf, -np.inf, np.nan, -1.0], dtype=kind)
    anything = rng.integers(0, np.iinfo(bits).max, 100_000, dtype=bits).view(kind)
    x = np.concatenate([squares, powers, ends, anything])
    with np.errstate(all="ignore"):
        x = np.concatenate([x, np.nextafter(x, kind(0.0)), np.nextafter(x, kind(np.inf))])
    y = np.empty_like(x)
    ctypes.CDLL(str(library)).all(ctypes.c_long(len(x)), *(a.ctypes.data_as(ctypes.c_void_p) for a in (x, y)))
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(y, np.sqrt(x))


def test_layers_are_loops_over_tables(tmp_path):
    _, source, _ = export_c("law", load_policy("ppo-robust"), tmp_path)
    text = source.read_text(encoding="utf-8")
    sizes = set(map(int, re.findall(r"static const double \w+\[(\d+)\] = ", text)))
    assert {20 * 128, 128 * 128, 128 * 2} <= sizes
    assert max(map(len, text.splitlines())) < 400
    bounds = set(map(int, re.findall(r"for \(int \w+ = 0; \w+ < (\w+); \w+\+\+\)", text)))
    assert bounds >= {20 // 4, 128 // 4, 128, 2}


def test_a_network_that_is_too_large_is_one_line(tmp_path, capsys):
    bundle = load_policy("ppo-nominal").bundle
    width, inputs = 600, bundle.network.sizes[0]
    shapes = (width, inputs), (width, width), (2, width)
    weights = tuple(np.zeros(shape, dtype=np.float32) for shape in shapes)
    biases = tuple(np.zeros(len(weight), dtype=np.float32) for weight in weights)
    network = Network(bundle.network.mean, bundle.network.std, bundle.network.clip, weights, biases)
    dataclasses.replace(bundle, network=network).save(tmp_path / "large")
    assert main(["export", "c", str(tmp_path / "large"), "--out", str(tmp_path / "new")]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and not (tmp_path / "new").exists()
    assert "numbers in its tables or layers; allowed: 262144" in err
