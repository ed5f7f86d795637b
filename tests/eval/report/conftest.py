"""One small evaluation on disk and its report, for all tests of the report."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import browser
from support.altered_evaluations import NASTY, wild, with_runs, write

from fuzzyarm.cli import main
from fuzzyarm.eval.evaluation.run import Evaluation, EvaluationConfig, evaluate


@pytest.fixture(scope="session")
def evaluation() -> Evaluation:
    return evaluate(
        EvaluationConfig(policies=("fuzzy-4", "computed-torque", "fuzzy-4-tip"), cases=("nominal", "machining"))
    )


@pytest.fixture(scope="session")
def folder(evaluation, tmp_path_factory) -> Path:
    """The evaluation of three policies in two cases, with its report."""
    path = write(evaluation, tmp_path_factory.mktemp("report") / "evaluation")
    assert main(["report", str(path)]) == 0
    return path


@pytest.fixture(scope="session")
def nasty_folder(evaluation, tmp_path_factory) -> Path:
    """Computed torque and a wild policy with a nasty name."""
    runs = []
    for run in evaluation.rollouts:
        if run.policy == "computed-torque":
            runs += [run, wild(run, NASTY, 700)]
    made = with_runs(evaluation, runs)
    path = write(made, tmp_path_factory.mktemp("nasty") / "evaluation")
    assert main(["report", str(path)]) == 0
    return path


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items) -> None:
    """Let the tests in a browser be slow ones: they take a minute, and are skipped where there is none."""
    for item in items:
        if "chromium" in item.fixturenames:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def chromium() -> Iterator[browser.Tab]:
    if browser.executable() is None:
        if os.environ.get("CI_BROWSER") == "1":
            pytest.fail("CI_BROWSER=1 demands Chromium: apt-get install chromium")
        pytest.skip("Chromium is not installed (apt-get install chromium)")
    with browser.chromium() as tab:
        yield tab


@pytest.fixture
def stored(folder) -> dict:
    return json.loads((folder / "results.json").read_text())
