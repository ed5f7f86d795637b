"""Fixtures of the paper's tests, which are computed once in some seconds."""

import pytest

from fuzzyarm.eval.paper.drift import load_expected
from fuzzyarm.eval.paper.evidence import STEPS, gather
from fuzzyarm.eval.paper.report import compare


@pytest.fixture(scope="session")
def evidence():
    steps = []
    gathered = gather(lambda: steps.append(None))
    assert len(steps) == STEPS
    return gathered


@pytest.fixture(scope="session")
def comparison(evidence):
    return compare(evidence, load_expected())
