"""Scripts of `benchmarks/` as modules."""

import importlib
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))  # as if they were run from their folder


@pytest.fixture
def module():
    """Return a function that imports a script by its name."""
    return importlib.import_module
