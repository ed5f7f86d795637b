"""The provenance that makes a result reproducible, and the JSON text of a document of results."""

import datetime
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

__all__ = ["current_provenance", "installed", "json_text", "made_now", "version_of"]

_LIBRARIES = ("fuzzyarm", "numpy", "llvmlite", "gymnasium", "scipy", "clarabel", "python-flint")


def current_provenance() -> dict[str, Any]:
    """Return commit, machine, and the versions of Python and the libraries, as results store them.

    The commit is None outside a git checkout of the package.
    """
    return {
        "commit": _commit(),
        "versions": {"python": platform.python_version(), **{name: version_of(name) for name in _LIBRARIES}},
        "machine": {"system": platform.platform(), "cpu": _cpu(), "cores": os.cpu_count()},
    }


def made_now(command: str | None) -> dict[str, Any]:
    """Return the beginning of a results document: its `command` line, if any, the date, and `current_provenance`."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"command": command, "date": now, **current_provenance()}


def json_text(document: Mapping[str, Any]) -> str:
    """Return a results document as JSON text for a file."""
    return json.dumps(document, indent=1) + "\n"


def installed() -> dict[str, str]:
    """Return the versions of Python, libraries and system for a bug report."""
    versions = {name: version_of(name) for name in (*_LIBRARIES[1:], "torch", "stable-baselines3")}
    return {
        "Python": platform.python_version(),
        **{name: version for name, version in versions.items() if version is not None},
        "on": platform.platform(),
    }


def version_of(name: str) -> str | None:
    """Return the version of a package; None where it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    """Return the commit of the package's own checkout, with "+changes" if its files differ from it."""
    folder = Path(__file__).parent
    try:
        commit = _git("rev-parse", "HEAD", cwd=folder)
        return commit + ("+changes" if _git("status", "--porcelain", "--", "..", cwd=folder) else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _git(*arguments: str, cwd: Path) -> str:
    # `ls-files` fails for a package that is installed inside a checkout of another project.
    subprocess.run(
        ["git", "ls-files", "--error-unmatch", __file__], cwd=cwd, check=True, capture_output=True, timeout=10
    )
    # Without `--no-optional-locks`, a `git status` that is killed leaves a lock in the checkout.
    command = ["git", "--no-optional-locks", *arguments]
    done = subprocess.run(command, cwd=cwd, check=True, capture_output=True, text=True, timeout=10)
    return done.stdout.strip()


def _cpu() -> str:
    """Return the processor's name; on Linux `platform` knows only its architecture."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
