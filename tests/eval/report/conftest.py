"""One small evaluation on disk and its report, for all tests of the report."""

import os

import pytest
from support import browser
from support.altered_evaluations import NASTY, scaled, wild, with_runs, write

from fuzzyarm.cli import main
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate
from fuzzyarm.policies import COMPARED


def reported(evaluation, folder):
    """Write an evaluation into the folder with its report."""
    assert main(["report", str(write(evaluation, folder))]) == 0
    return folder


@pytest.fixture(scope="session")
def evaluation():
    policies = "fuzzy-4", "computed-torque", "fuzzy-4-tip"
    return evaluate(EvaluationConfig(policies=policies, cases=("nominal", "machining")))


@pytest.fixture(scope="session")
def folder(evaluation, tmp_path_factory):
    """The evaluation of three policies in two cases, with its report."""
    return reported(evaluation, tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="session")
def nasty_folder(evaluation, tmp_path_factory):
    """Computed torque and a wild policy with a nasty name."""
    own = [run for run in evaluation.rollouts if run.policy == "computed-torque"]
    runs = [made for run in own for made in (run, wild(run, NASTY, 700))]
    return reported(with_runs(evaluation, runs), tmp_path_factory.mktemp("nasty"))


@pytest.fixture(scope="session", params=[12])
def many_folder(request, evaluation, tmp_path_factory):
    """Twelve policies in three cases, the fourth the best and the third case the hardest, or the first of these."""
    nominal, machining = (evaluation.rollouts[k] for k in (0, 3))
    cases = [(nominal, "nominal", 0.1), (machining, "machining", 1.0), (machining, "payload", 1.1)]
    factors = [1.4, 1.3, 1.2, 0.4, 1.1, 0.6, 0.5, 1.0, 0.7, 0.8, 0.9, 1.5]
    names = [*COMPARED, "ppo-nominal", "fuzzy-4-sampled-tip", "my.controller:make_observer"]
    runs = [
        scaled(run, name, share * factor, case=case)
        for run, case, share in cases
        for name, factor in list(zip(names, factors, strict=True))[: request.param]
    ]
    if request.param == len(names):
        runs[-1] = wild(runs[-1], names[-1], 700)
    return reported(with_runs(evaluation, runs), tmp_path_factory.mktemp("many"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Let the tests in a browser be slow ones: they take a minute, and are skipped where there is none."""
    for item in items:
        if "chromium" in item.fixturenames:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def chromium():
    if browser.executable() is None:
        if os.environ.get("CI_BROWSER") == "1":
            pytest.fail("CI_BROWSER=1 demands Chromium: apt-get install chromium")
        pytest.skip("Chromium is not installed (apt-get install chromium)")
    with browser.chromium() as tab:
        yield tab
