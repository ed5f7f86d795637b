"""Settings of all tests: the expected duration is printed first, and each process uses one core."""

from __future__ import annotations

import gc
import os

import hypothesis
import pytest

hypothesis.settings.register_profile(
    "fuzzyarm", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)  # a loaded machine is no fault of a test
hypothesis.settings.load_profile("fuzzyarm")

# Read when the libraries are imported. Processes that run side by side would else wait for each other's threads.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

FAST, SLOW = 4.0, 15.0  # min of processor time on an AMD EPYC; the slow ones on an Intel Xeon, the sum of their parts
COMPILING = 2.1  # min more the first time

# Files of tests, see `pytest_collection_modifyitems`.
_COMPILING = "test_vector.py", "test_laws.py"
_TOGETHER = (  # whose tests share what takes seconds to compute, or to compile
    ("tests/eval/paper/",),
    ("tests/fuzzy_policy/laws/test_laws.py", "tests/fuzzy_policy/laws/learned/test_learned_observer.py"),
)
_PROOFS = (
    "test_theorems.py",
    "test_extreme_designs.py",
    "test_design.py",
    "test_tube.py",
    "test_scheduled_certificate.py",
    "test_help.py",
    "test_residual.py",
    "test_design_problem.py",
    "test_certificate.py",
    "test_stated_numbers.py",
    "test_forged_files.py",
)


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
    """Let the first of two processes begin with what compiles the simulation and the laws, the second with proofs.

    The files are handed out in this order, two to each process and then one by one. If both began with a simulation,
    both would compile the same kernels.
    """
    first = [_COMPILING[0], *_PROOFS[:1], _COMPILING[1], *_PROOFS[1:]]
    places = {name: place for place, name in enumerate(first)}
    items.sort(key=lambda item: places.get(item.path.name, len(first)))


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what is imported and collected by now: it stays to the end."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out the tests by file, and those of each group of `_TOGETHER` as if they were one file."""
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return next((group[0] for group in _TOGETHER if file.startswith(group)), file)

    return Scheduling(config, log)


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Let `fuzzyarm evaluate` and `fuzzyarm sweep` draw no figures, which take longer than the episodes."""
    monkeypatch.setattr(
        "fuzzyarm.eval.evaluation.figures.write_figures", lambda rollouts, folder, progress=None, titles=None: []
    )
    monkeypatch.setattr("fuzzyarm.eval.sweep._figures.write_sweep_figures", lambda *_: [])


@pytest.fixture
def unmeasured(monkeypatch) -> None:
    """Let `fuzzyarm design` measure no margins, which takes longer than a small design."""
    monkeypatch.setattr("fuzzyarm.eval.stability.margins.margins_in_words", lambda *_: "")


@pytest.fixture
def few_postures(monkeypatch) -> None:
    """Let margins be taken at 4 postures of the path, not at 16."""
    monkeypatch.setattr("fuzzyarm.eval.stability._linearisation.POSTURES", 4)
