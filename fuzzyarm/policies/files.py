"""The files a policy is made from, each with its SHA-256, so that another file of the same name is noticed."""

from __future__ import annotations

import hashlib
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from fuzzyarm.learned_policy.bundle import DESCRIPTION, PolicyBundle
from fuzzyarm.policies.registry import LEARNED, NAMES, TIP, is_code
from fuzzyarm.policies.user_code import imported


def policy_files(name: str) -> dict[str, str]:
    """Return the SHA-256 by name of the files that `find_policy` makes a policy from.

    A controller file; ``policy.json`` of a learned policy, which holds that of the weights, and the file of its base;
    of ``package.module:factory``, which is imported, the module's own source. None for computed torque, which is a part
    of this package, nor for a policy that there is not.

    Raises:
        ValueError: a learned policy is damaged, or a module fails.
        OSError: a file cannot be read.
    """
    if is_code(name):
        source = imported(name).__file__
        return {} if source is None else {Path(source).name: _sha256(Path(source))}
    name = name.removesuffix(TIP)
    if name in LEARNED:
        with resources.as_file(resources.files("fuzzyarm.learned_policy.policies") / name) as folder:
            return _learned(folder)
    if name in NAMES:
        file = resources.files("fuzzyarm.fuzzy_policy.controllers") / f"{name}.json"
        return {file.name: _sha256(file)} if file.is_file() else {}
    if name.endswith(".json"):
        return {Path(name).name: _sha256(Path(name))}
    return _learned(Path(name)) if Path(name).is_dir() else {}


def _learned(folder: Path) -> dict[str, str]:
    base = PolicyBundle.load(folder).action.base
    return {DESCRIPTION: _sha256(folder / DESCRIPTION)} | ({} if base is None else policy_files(base))


def _sha256(file: Path | Traversable) -> str:
    """Return the SHA-256 of a text file, which is the same with the line ends of another system."""
    return hashlib.sha256(file.read_bytes().replace(b"\r\n", b"\n")).hexdigest()
