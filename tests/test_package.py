"""The cost of imports, and which part may import which."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
HEAVY = ("cvxpy", "clarabel", "torch", "stable_baselines3", "matplotlib", "pygame", "rich")


@pytest.mark.parametrize(
    "statement",
    [
        "import fuzzyarm",
        "import gymnasium, fuzzyarm; gymnasium.make('FuzzyArm-v0').reset(seed=0)",
        "import fuzzyarm; fuzzyarm.load_policy('fuzzy-4'); fuzzyarm.load_policy('computed-torque')",
    ],
)
def test_nothing_heavy_is_loaded(statement):
    code = f"{statement}; import sys; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_import_contracts_hold():
    done = subprocess.run(["lint-imports"], cwd=ROOT, capture_output=True, text=True, check=False, env=_environment())
    assert done.returncode == 0, done.stdout


def _environment():
    import os

    return os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def test_an_edit_of_a_source_changes_the_name_of_its_machine_code():
    """Numba caches by file: the digest in the kernel's name is what keeps stale code out."""
    from fuzzyarm.envs.physics.compiled import _digest
    from fuzzyarm.envs.physics.integrator import hold
    from fuzzyarm.fuzzy_policy.laws.fuzzy import _fuzzy_law

    physics, laws = ("common", "envs"), ("common", "envs", "fuzzy_policy")
    assert hold.py_func.__qualname__.endswith(_digest(physics))
    assert _fuzzy_law.py_func.__qualname__.endswith(_digest(laws))
    code = (
        f"import pathlib, fuzzyarm.envs.physics.compiled as c; rooms = {laws}; before = c._digest(rooms); "
        "c._digest.cache_clear(); old = pathlib.Path.read_bytes; "
        "pathlib.Path.read_bytes = lambda p: old(p) + b' '; print(before != c._digest(rooms))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True"
