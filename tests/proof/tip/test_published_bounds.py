"""The files of the published bounds, made by their command and checked by `fuzzyarm verify`."""

import subprocess
import sys
from pathlib import Path

import pytest

from fuzzyarm.cli import main

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "tip_bound.py"


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_every_published_bound_is_found_again_and_its_file_is_proven(tmp_path, capsys):
    made = subprocess.run([sys.executable, BENCHMARK, "--files", tmp_path], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    assert main(["verify", *map(str, sorted(tmp_path.glob("*.json")))]) == 0
