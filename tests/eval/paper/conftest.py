"""Fixtures of the paper's tests, which are computed once in some seconds."""

from pathlib import Path

import pytest

from fuzzyarm.eval.paper._report import compare, load_expected
from fuzzyarm.eval.paper.evidence import gather
from fuzzyarm.policies import load_policy


def loaded(policy):
    return load_policy(policy, allow_unproven=Path(policy).stem in ("paper-32-integral", "fuzzy-32"))


@pytest.fixture(scope="session")
def evidence():
    """What `gather` returns; the proofs with 32 rules are left to `test_every_file_is_proven`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fuzzyarm.eval.paper.evidence.load_policy", loaded)
        return gather()


@pytest.fixture(scope="session")
def comparison(evidence):
    return compare(evidence, load_expected())
