"""The modules of the user's own policies: which files they are, so that they can be compared and sent to a cluster.

A policy ``package.module:factory`` is the whole top-level package, as its modules may import each other; a module that
lies in no package is its own file. What is installed on this machine (in ``site-packages``) is expected to be installed
on all machines, and is neither sent nor compared beyond the module itself.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from pathlib import Path

from fuzzyarm.common.documents import read_bytes
from fuzzyarm.policies import Kind, PolicySpec

__all__ = ["module_files", "module_sources"]

_INSTALLED = {"site-packages", "dist-packages"}
"""Names of the folders that Python packages are installed in."""


def module_sources(specs: Iterable[PolicySpec]) -> tuple[Path, ...]:
    """Return the package folders and module files of all policies that are the user's code, each once.

    The modules must have been imported, which loading the policies does.
    """
    sources = (_source(spec) for spec in specs if spec.kind is Kind.CODE)
    return tuple(dict.fromkeys(source for source in sources if source is not None))


def module_files(spec: PolicySpec) -> dict[str, str]:
    """Return the SHA-256 of the Python files that a policy of the user's code may be made from, by path.

    The paths are relative to the folder that is imported from. Empty for every other policy.
    """
    source = _source(spec) if spec.kind is Kind.CODE else None
    if source is None:
        return {}
    files = sorted(source.rglob("*.py")) if source.is_dir() else [source]
    return {file.relative_to(source.parent).as_posix(): hashlib.sha256(read_bytes(file)).hexdigest() for file in files}


def _source(spec: PolicySpec) -> Path | None:
    """Return the top-level package's folder or the module's file; None if it is installed or built in."""
    top = spec.name.partition(":")[0].partition(".")[0]
    module = sys.modules[top]
    path = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
    if top == "fuzzyarm" or path is None:
        return None
    file = Path(path).absolute()
    source = file.parent if file.name == "__init__.py" else file
    return None if _INSTALLED & set(source.parts) else source
