"""Observed values beside the certified bounds: they agree with the benchmark, keep the bounds, or have a reason."""

import dataclasses
import json
from pathlib import Path

import pytest

from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.eval.report.certificates import observe_policies
from fuzzyarm.policies import load_policy
from fuzzyarm.proof.policy_certificate import certificate_of

ROOT = Path(__file__).parents[3]
STORED = json.loads((ROOT / "benchmarks" / "results" / "certified_bounds.json").read_text())["bounds"]["fuzzy-4"]
CLAIMED = certificate_of(load_policy("fuzzy-4"), JointReference()).bounds


@pytest.fixture(scope="module")
def controller():
    return load_policy("fuzzy-4").controller


def assert_within_the_certificate(controller, seen):
    assert controller.alpha <= seen.decay and seen.gain <= controller.gamma
    assert seen.probe == "worst torque found"


def test_of_a_short_motion_it_is_the_decay_and_nearly_the_gain_of_the_benchmark(controller, seen):
    """The gain of a part of a motion is no larger; at the worst posture 0.3 s are enough for all but 2 % of it.

    Along the circle alone it would be 8 % less.
    """
    decay, gain = STORED["decay_per_s"]["observed"], STORED["gain_rad_per_Nm"]["observed"]
    assert seen.decay == pytest.approx(decay, rel=2e-3)
    assert 0.98 * gain < seen.gain < gain
    assert_within_the_certificate(controller, seen)


@pytest.fixture
def quick(monkeypatch):
    """Count the calls of `observe`, which returns at once."""
    calls = []
    monkeypatch.setattr(
        "fuzzyarm.eval.report.certificates.observe", lambda loop, reference: calls.append(loop) or "seen"
    )
    return calls


def test_a_file_is_observed_once_for_all_its_policies(quick):
    config = EvaluationConfig(policies=("fuzzy-4", "computed-torque", "fuzzy-4-tip"))
    bounds = {"fuzzy-4": CLAIMED, "computed-torque": None, "fuzzy-4-tip": CLAIMED}
    assert observe_policies(config, bounds) == {"fuzzy-4": "seen", "fuzzy-4-tip": "seen"}
    assert len(quick) == 1


def test_a_changed_or_lost_file_is_told_and_not_observed(quick, controller, tmp_path):
    path = tmp_path / "mine.json"
    config = EvaluationConfig(policies=(str(path),))
    assert "is gone" in observe_policies(config, {"mine": CLAIMED})["mine"]
    load_policy("fuzzy-1").controller.save(path)
    assert "has changed since" in observe_policies(config, {"mine": CLAIMED})["mine"]
    dataclasses.replace(controller, alpha=60.0).save(path)
    assert "no longer proven" in observe_policies(config, {"mine": CLAIMED})["mine"]
    controller.save(path)
    assert observe_policies(config, {"mine": CLAIMED}) == {"mine": "seen"}
    assert len(quick) == 1
