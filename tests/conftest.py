"""Settings of all tests: the expected duration is printed first, and each process uses one core."""

from __future__ import annotations

import os

import pytest

# Read when the libraries are imported. Processes that run side by side would else wait for each other's threads.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

FAST, SLOW = 5.5, 12.0  # min of processor time on an Intel Xeon; the slow ones by the sum of their parts
COMPILING = 1.4  # min more the first time

_NO_SIMULATION = {"synthesis", "proof"}  # folders of tests


def pytest_report_header(config) -> str:
    """Return the line about the expected duration on this machine."""
    workers = config.getoption("numprocesses", None) or 1
    slow = config.getoption("markexpr") == "slow"
    minutes = (SLOW if slow else FAST) / workers
    which = "slow" if slow else "fast"
    return (
        f"fuzzyarm: all {which} tests take about {minutes:.0f} min with {workers} processes, "
        f"the first time {minutes + COMPILING / workers:.0f} min, since the simulation is compiled"
    )


def pytest_ignore_collect(collection_path, config) -> bool | None:
    """Leave out `tests/abuse`, whose tests are all slow, where slow tests are: its samples take seconds to import."""
    return True if collection_path.name == "abuse" and config.getoption("markexpr") == "not slow" else None


def pytest_collection_modifyitems(items) -> None:
    """Let the first of two processes begin with what compiles the simulation, the second with what needs none of it.

    Each process is given an equal share of consecutive tests and takes from the others when it is done. If both began
    with a simulation, both would compile the same kernels.
    """
    still = [item for item in items if _NO_SIMULATION.intersection(item.path.parts)]
    rest = [item for item in items if not _NO_SIMULATION.intersection(item.path.parts)]
    rest.sort(key=lambda item: item.path.name != "test_readme.py")  # it uses every kernel
    half = len(items) // 2
    items[:] = [*rest[:half], *still, *rest[half:]]


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Let `fuzzyarm evaluate` draw no figures, which take longer than the episodes."""
    monkeypatch.setattr(
        "fuzzyarm.eval.evaluation.figures.write_figures", lambda rollouts, folder, progress=None, titles=None: []
    )
