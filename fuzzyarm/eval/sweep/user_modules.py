"""The modules of the user's own policies and cases: which files they are, to be compared and sent to a cluster.

A module stands for its whole top-level package, as its modules may import each other; one that lies in no package is
its own file. What is installed on this machine (in ``site-packages``) is expected to be installed on all machines, and
is neither sent nor compared beyond the module itself.
"""

from __future__ import annotations

import hashlib
import pickletools
import sys
from pathlib import Path

from fuzzyarm.common.documents import read_bytes
from fuzzyarm.policies import Kind, PolicySpec

__all__ = ["module_files", "module_sources"]

_INSTALLED = {"site-packages", "dist-packages"}
"""Names of the folders that Python packages are installed in."""


def module_sources(pickled: bytes) -> tuple[Path, ...]:
    """Return the package folders and module files of the user's that a pickle refers to, each once."""
    words = {word.partition(".")[0] for _, word, _ in pickletools.genops(pickled) if isinstance(word, str)}
    sources = (_source(top) for top in sorted(words & set(sys.modules)))
    return tuple(dict.fromkeys(source for source in sources if source is not None))


def module_files(spec: PolicySpec) -> dict[str, str]:
    """Return the SHA-256 of the Python files that a policy of the user's code may be made from, by path.

    The paths are relative to the folder that is imported from. Empty for every other policy.
    """
    source = _source(spec.name.partition(":")[0].partition(".")[0]) if spec.kind is Kind.CODE else None
    if source is None:
        return {}
    files = sorted(source.rglob("*.py")) if source.is_dir() else [source]
    return {file.relative_to(source.parent).as_posix(): hashlib.sha256(read_bytes(file)).hexdigest() for file in files}


def _source(top: str) -> Path | None:
    """Return a top-level package's folder or a module's file; None if it is installed, built in or what is run."""
    module = sys.modules[top]
    path = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
    if top in {"fuzzyarm", "__main__", "__mp_main__", *sys.stdlib_module_names} or path is None:
        return None
    file = Path(path).absolute()
    source = file.parent if file.name == "__init__.py" else file
    return None if _INSTALLED & set(source.parts) else source
