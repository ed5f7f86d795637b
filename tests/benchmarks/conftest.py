"""Scripts of `benchmarks/` as modules."""

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def module(monkeypatch):
    """Return a function that imports a script as if run from its folder."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module
