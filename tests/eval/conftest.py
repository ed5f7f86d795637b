"""What the tests of this folder share: proofs of the controllers that they load, and shorter episodes."""

import functools
import json
import pickle
from unittest import mock

import pytest

from fuzzyarm.eval.episodes import loop
from fuzzyarm.policies import _controller_policy as controller_policy
from fuzzyarm.proof.certificate import certify


@functools.cache
def verdict(numbers):
    return certify(pickle.loads(numbers))


@pytest.fixture(scope="module", autouse=True)
def proofs_are_kept():
    """Let the policies that are loaded share their proofs, which other folders test."""
    with mock.patch.object(controller_policy, "certify", lambda controller: verdict(pickle.dumps(controller))):
        yield


SHORT = 300  # steps, of 1500


def first_steps(*given, **more):
    """The first `SHORT` steps of `episodes`, as if the reference ended there."""
    for k, step in enumerate(loop.episodes(*given, **more), 1):
        if k == SHORT:
            yield step._replace(ended=step.running, completed=step.running)
            return
        yield step


@pytest.fixture
def short(monkeypatch):
    """Let the episodes of sweeps and evaluations in this process have 300 of 1500 steps, and return that number.

    What is compared step by step, or is said of files, is the same after a fifth of the circle.
    """
    monkeypatch.setattr("fuzzyarm.eval.sweep._episodes.episodes", first_steps)
    monkeypatch.setattr("fuzzyarm.eval.episodes.rollout.episodes", first_steps)
    return SHORT


@pytest.fixture
def write(tmp_path):
    """Return a function that writes the results of an evaluation or of a sweep into a folder of their own."""

    def file(name, content):
        (tmp_path / name).mkdir()
        path = tmp_path / name / ("sweep.json" if "rows" in content else "results.json")
        path.write_text(json.dumps(content), encoding="utf-8")
        return path

    return file
