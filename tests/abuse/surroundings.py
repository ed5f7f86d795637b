"""Commands in other surroundings: closed streams, full devices, no home, other locales and terminals."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from .command_line import check_errors
from .processes import EVALUATE, PATIENCE, check_whole, uninterrupted
from .samples import evaluation, scratch
from .surface import Broken, Surface, Try

__all__ = ["SURFACES"]


def _streams(rng: np.random.Generator) -> Try:
    """Real processes with other surroundings: closed streams, a full device, no home, another locale."""
    words = SHORT[rng.integers(len(SHORT))]
    names = list(SURROUNDINGS)
    name = names[rng.integers(len(names))]

    def run() -> None:
        folder = scratch()
        shutil.copytree(evaluation(), folder / "evaluation")
        shutil.copy(
            Path(__file__).parents[2] / "fuzzyarm/fuzzy_policy/controllers/fuzzy-1.json", folder / "controller.json"
        )
        changes, redirection, codes = SURROUNDINGS[name]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", **{one: value for one, value in changes.items() if value}}
        for one in (one for one, value in changes.items() if not value):
            environment.pop(one, None)
        environment["PYTHONPATH"] = str(Path(__file__).parents[2])
        line = " ".join([f"'{sys.executable}' -m fuzzyarm", *words, redirection])
        done = subprocess.run(
            ["bash", "-c", f"set -o pipefail; {line}"],
            cwd=folder,
            env=environment,
            capture_output=True,
            timeout=PATIENCE,
        )
        err = done.stderr.decode(errors="replace")
        if done.returncode not in codes:
            raise Broken(f"exit code {done.returncode}, expected {codes}: {err[-300:]!r}")
        check_errors(done.returncode, err, heard="2>&-" not in redirection)
        check_whole(folder)
        if done.returncode == 2 and ">&-" in redirection and (folder / "out").exists():
            raise Broken("refused before anything ran, but left a folder")

    return Try(f"fuzzyarm {' '.join(words)}: {name}", run)


SHORT = (
    ["verify", "controller.json"],
    ["verify", "controller.json", "--json"],
    ["leaderboard", "evaluation"],
    ["leaderboard", "evaluation", "--markdown"],
    ["--help"],
    ["evaluate", "--help"],
    EVALUATE,
    [*EVALUATE, "--json"],
)
"""Command lines that succeed."""
SURROUNDINGS: dict[str, tuple[dict[str, str], str, tuple[int, ...]]] = {
    "standard output closed": ({}, ">&-", (0, 2)),
    "standard error closed": ({}, "2>&-", (0,)),
    "all streams closed": ({}, "<&- >&- 2>&-", (0, 2)),
    "a reader that leaves": ({}, "| true", (0, 141)),
    "a reader of one line": ({}, "| head -1 > first", (0, 141)),
    "a full device": ({}, "> /dev/full", (2,)),
    "no home": ({"HOME": "/nowhere", "XDG_CACHE_HOME": "/nowhere", "XDG_CONFIG_HOME": "/nowhere"}, "", (0,)),
    "a home that is a file": ({"HOME": "/dev/null", "MPLCONFIGDIR": "/dev/null/x"}, "", (0,)),
    "no environment to speak of": ({"HOME": "", "USER": "", "LOGNAME": "", "TERM": "", "LANG": ""}, "", (0,)),
    "a plain locale": ({"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}, "", (0, 2)),
    "a terminal of one column": ({"COLUMNS": "1", "TERM": "dumb"}, "", (0,)),
    "columns that are no number": ({"COLUMNS": "x", "LINES": "-1", "NO_COLOR": "1"}, "", (0,)),
    "an unknown backend of figures": ({"MPLBACKEND": "nope"}, "", (0, 2)),
    "warnings are errors of others": ({"PYTHONWARNINGS": "ignore", "PYTHONOPTIMIZE": "2"}, "", (0,)),
}
"""By name: the environment, redirections, and exit codes that may come of a command line that succeeds elsewhere."""

SURFACES = (Surface("surroundings", "processes", 60, _streams, prepare=lambda: uninterrupted("evaluate")),)
