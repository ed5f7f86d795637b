"""The cost of imports, and which part may import which."""

import ast
import functools
import importlib
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
HEAVY = ("cvxpy", "clarabel", "torch", "stable_baselines3", "matplotlib", "pygame", "rich")


def test_nothing_heavy_is_loaded():
    """By any of these, one after the other in one process."""
    statements = [
        "import sys, fuzzyarm",
        "import gymnasium; gymnasium.make('FuzzyArm-v0').reset(seed=0)",
        "fuzzyarm.load_policy('fuzzy-4'); fuzzyarm.load_policy('computed-torque')",
    ]
    shown = f"print([name for name in {HEAVY!r} if name in sys.modules])"
    code = "".join(f"{statement}; {shown}\n" for statement in statements)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]"] * len(statements)


def test_import_contracts_hold():
    done = subprocess.run(["lint-imports"], cwd=ROOT, capture_output=True, text=True, check=False, env=_environment())
    assert done.returncode == 0, done.stdout


def _environment():
    import os

    return os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


PACKAGE = ROOT / "fuzzyarm"
SOURCES = sorted(PACKAGE.rglob("*.py"))
MENTIONED = re.compile(r"(?<!`)`((?:\w+\.)+\w+)`(?!`)")
"""A name in single backticks with a dot in it, as `layout.Work`."""


def module_name(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def texts(path):
    source = path.read_text(encoding="utf-8")
    if not MENTIONED.search(source):  # parsing takes long
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield ast.get_docstring(node) or ""


@functools.cache
def modules_by_their_last_name():
    homes = {}
    for name in map(module_name, SOURCES):
        homes.setdefault(name.rpartition(".")[2], []).append(name)
    return homes


@functools.cache
def found(name):
    """Whether a dotted name that begins with a module of the package, or the end of one, is there; None for others."""
    first, *rest = name.split(".")
    homes = modules_by_their_last_name().get(first)
    if not homes or first in ("spec", "data"):  # names of attributes in what Gymnasium and the proofs hand over
        return None
    return any(resolves(home, rest) for home in homes)


def resolves(module, names):
    at = importlib.import_module(module)
    for name in names:
        if not hasattr(at, name) and hasattr(at, "__path__") and importlib.util.find_spec(f"{at.__name__}.{name}"):
            importlib.import_module(f"{at.__name__}.{name}")
        if not hasattr(at, name):
            return False
        at = getattr(at, name)
    return True


@pytest.mark.parametrize("folder", sorted({path.parent for path in SOURCES}), ids=module_name)
def test_what_docstrings_refer_to_exists(folder):
    for path in folder.glob("*.py"):
        if "ray_backend" not in path.name:
            mentioned = [name for text in texts(path) for name in MENTIONED.findall(text)]
            assert [name for name in mentioned if found(name) is False] == [], path
