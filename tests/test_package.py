"""The cost of imports, and which part may import which."""

import contextlib
import os
import pkgutil
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
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(["lint-imports"], cwd=ROOT, capture_output=True, text=True, env=os.environ | {"PATH": path})
    assert done.returncode == 0, done.stdout


MODULES = {
    path: ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in sorted((ROOT / "fuzzyarm").rglob("*.py"))
}
MENTIONED = re.compile(r"(?<!`)`((?:\w+\.)+\w+)`(?!`)")
"""A name in single backticks with a dot in it, as `layout.Work`."""
OTHERS = ("spec", "data")  # attributes in what Gymnasium and the proofs hand over


def exists(name):
    """Whether a dotted name is there that begins with a module of the package, or the end of one."""
    first, rest = name.split(".", 1)
    homes = [module for module in MODULES.values() if module.rpartition(".")[2] == first]
    for home in homes:
        with contextlib.suppress(ImportError, AttributeError):
            return pkgutil.resolve_name(f"{home}.{rest}") is not None
    return first in OTHERS or not homes


@pytest.mark.parametrize("folder", sorted({path.parent for path in MODULES}), ids=lambda path: path.name)
def test_what_the_texts_of_modules_refer_to_exists(folder):
    for path in folder.glob("*.py"):
        if "ray_backend" not in path.name:
            mentioned = MENTIONED.findall(path.read_text(encoding="utf-8").replace(".toml`", ""))
            assert [name for name in mentioned if not exists(name)] == [], path
