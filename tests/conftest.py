"""What holds for all tests: how long they take is said first, and each process of theirs keeps to one core."""

from __future__ import annotations

import os

import pytest

# Read when the libraries are imported. Processes that run side by side would else wait for each other's threads.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

FAST, SLOW = 4.5, 7.0  # min of processor time, as measured on a core of an AMD EPYC of 2023
COMPILING = 1.0  # min more the first time


def pytest_report_header(config) -> str:
    """Say how long the tests take on this machine."""
    workers = config.getoption("numprocesses", None) or 1
    slow = config.getoption("markexpr") == "slow"
    minutes = (SLOW if slow else FAST) / workers
    which = "slow" if slow else "fast"
    return (
        f"fuzzyarm: all {which} tests take about {minutes:.0f} min with {workers} processes, "
        f"the first time {minutes + COMPILING / workers:.0f} min, since the simulation is compiled"
    )


def pytest_collection_modifyitems(items) -> None:
    """Begin with the commands of the README, the longest test: last, it would keep one process busy on its own."""
    items.sort(key=lambda item: item.path.name != "test_readme.py")


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Let `fuzzyarm evaluate` draw no figures, which take longer than the episodes."""
    monkeypatch.setattr("fuzzyarm.eval.evaluation.figures.write_figures", lambda rollouts, folder, progress=None: [])
