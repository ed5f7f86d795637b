"""Observed values beside the certified bounds: they agree with the benchmark, keep the bounds, or have a reason."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.eval.report.certificates import checked_bounds, observe_policies, tube_section
from fuzzyarm.policies import load_policy
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.policies.tip_files import save_bound
from fuzzyarm.proof.policy_certificate import certificate_of
from fuzzyarm.proof.tip.plant import PlantSet

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


STEPS = 15


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    out = tmp_path_factory.mktemp("tube") / "bound.json"
    save_bound(find_bound(TipClaim("fuzzy-4-tip", "nominal", "table-1", PlantSet(), steps=STEPS)), out)
    return out


def test_the_simulated_tip_is_drawn_within_the_tube(evaluation, path):
    checks = checked_bounds([path])
    section = tube_section(checks, evaluation.rollouts)
    assert "fuzzy-4-tip: tip within" in section and "for set table-1, proven" in section
    drawn = {
        name: np.array([list(map(float, pair.split(","))) for pair in points.split()])
        for name, points in re.findall(r'class="(band|path|tip)" points="([^"]*)"', section)
    }
    outer, inner = drawn["band"][:STEPS], drawn["band"][: STEPS - 1 : -1]
    np.testing.assert_allclose(0.5 * (outer + inner), drawn["path"], atol=0.11)
    half = 0.5 * np.hypot(*(outer - inner).T)
    assert (np.hypot(*(drawn["tip"] - drawn["path"]).T) <= half + 0.2).all()  # a digit of a pixel each
    assert half.max() > 10.0 and np.hypot(*(drawn["tip"] - drawn["path"]).T).max() > 5.0


def test_a_bound_that_is_not_proven_or_of_another_episode_is_refused(evaluation, path, tmp_path):
    (check,) = checked_bounds([path])
    other = dataclasses.replace(check, claim=dataclasses.replace(check.claim, path="lemniscate"))
    with pytest.raises(ValueError, match="no episode of fuzzy-4-tip in case nominal along the lemniscate"):
        tube_section([other], evaluation.rollouts)
    content = json.loads(path.read_text())
    forged = tmp_path / "forged.json"
    forged.write_text(json.dumps(content | {"bound": 0.5 * content["bound"]}))
    with pytest.raises(ValueError, match=r"forged\.json is not proven"):
        checked_bounds([forged])
