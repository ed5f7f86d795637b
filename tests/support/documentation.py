"""The documentation, built once for all tests that look at it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def build(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Build the pages into a folder, warnings as errors; return what Sphinx said."""
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", *options, str(ROOT / "docs"), str(folder)]
    # Notebooks that ran before are not run again while their text is the same.
    environment = os.environ | {"TZ": "UTC"}
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=environment)
