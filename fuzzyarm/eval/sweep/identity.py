"""What the numbers of a sweep depend on: its configuration, the code, versions, added cases and files of its policies.

Results of different identities are never mixed in one folder.
"""

from __future__ import annotations

import functools
import hashlib
import json
import platform
import re
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import fuzzyarm
from fuzzyarm.common.checks import listed
from fuzzyarm.envs.scenario.cases import CASES, INSTANTS, Case
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.user_modules import module_files
from fuzzyarm.policies import PolicySpec

__all__ = ["SOURCES", "difference", "digest_of_identity", "made_with", "sweep_identity"]

_OWN = ("quantities", "distributions", "config", "plants", "episodes", "results")
SOURCES = (
    "common",
    "envs",
    "fuzzy_policy",
    "learned_policy",
    "numbers",
    "policies",
    "eval/episodes",
    *(f"eval/sweep/{name}.py" for name in _OWN),
)
"""Files and folders of the package that decide the numbers: code, controllers and weights."""


@functools.cache
def made_with() -> dict[str, str]:
    """Return the versions, and a digest of the sources, that this process computes with."""
    root = Path(fuzzyarm.__file__).parent
    versions = {name: version(name) for name in ("fuzzyarm", "numpy", "llvmlite")}
    return {"python": platform.python_version(), **versions, "code": _digest_of(root / name for name in SOURCES)}


def sweep_identity(config: SweepConfig, specs: Mapping[str, PolicySpec]) -> dict[str, Any]:
    """Return everything that the numbers of a sweep depend on, ready for JSON.

    Args:
        config: of the sweep.
        specs: its policies by label; code must be allowed to run, see `policies.resolve`.

    Raises:
        ValueError: a policy is damaged.
        OSError: a policy's file cannot be read.
    """
    files = {label: spec.files() | module_files(spec) for label, spec in specs.items()}
    axes = 2 if config.robot is None else 3
    added = {name: _described(case, axes) for name, case in CASES.added().items() if name in config.cases}
    identity = {"numbers": config.numbers(), "policies": files, "made_with": made_with()}
    return identity | {"cases": added} if added else identity


def difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return in words in which entries two mappings differ; empty if they do not."""
    found = []
    for key in dict.fromkeys([*one, *other]):
        then, now = one.get(key), other.get(key)
        if isinstance(then, Mapping) and isinstance(now, Mapping):
            inner = difference(then, now)
            found += [f"{listed([key])}: {inner}"] if inner else []
        elif then != now:
            found.append(f"{listed([key])} {_short(then)} and {_short(now)}")
    return ", ".join(found)


def digest_of_identity(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of an identity; every file of a sweep carries it."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _digest_of(paths: Iterable[Path]) -> str:
    """Return the SHA-256 of files and of all files in folders, except the caches of Python."""
    digest = hashlib.sha256()
    for path in paths:
        files = [path] if path.is_file() else sorted(path.rglob("*"))
        assert files, f"{path} is missing: SOURCES must follow the package's folders"
        for file in files:
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(file.relative_to(path.parent).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _described(case: Case, axes: int) -> str:
    """Return a digest of what an added case does: its fields as text, and its tip force at some instants."""
    force, t = case.disturbance.tip_force, np.linspace(0.0, 2.0, INSTANTS)
    text = re.sub(r" at 0x[0-9a-f]+", "", repr(case))
    velocity = np.stack([np.cos(t), np.sin(t), t][:axes], axis=-1)
    forces = b"" if force is None else np.asarray(force.at(t, velocity)).tobytes()
    return hashlib.sha256(text.encode() + forces).hexdigest()


def _short(value: Any) -> str:
    """Return the first characters of a value: enough to tell digests and versions apart."""
    return f"{listed([value]):.20}"
