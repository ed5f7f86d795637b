"""The held-out set and the score: an independent run of single episodes, and what the set is made of."""

import json

import numpy as np
import pytest
from support.command_line import printed

from fuzzyarm import ArmParameters, load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.eval import score
from fuzzyarm.eval.episodes.rollout import record_rollout

SMALL = score._held_out("test", each=2)


def test_the_score_is_that_of_each_episode_run_alone():
    policy = load_policy("computed-torque")
    found = score._score_of(policy, SMALL)
    for k in (0, 2, 4):  # without noise, which has a stream for each lane
        env = FuzzyArmEnv(disturbance=SMALL.disturbances[k], reference=SMALL.references[k], parameters=SMALL.arms[k])
        run = record_rollout(env, policy, policy_name="", case="", seed=0)
        d = run.tip_error
        each = np.where(d <= 0.2, 1 - np.log1p(d / 1e-5) / np.log1p(0.2 / 1e-5), 0.0)
        assert found.S[k] == pytest.approx(each.sum() / round(1e3 * SMALL.references[k].duration), rel=1e-12)
        assert found.rms[k] == pytest.approx(np.sqrt(np.mean(d**2)), rel=1e-12)
        rates = np.mean(np.diff(run.torque, axis=0) ** 2, axis=1).sum() / len(d)
        assert found.rate[k] == pytest.approx(1e3 * np.sqrt(rates), rel=1e-12)
        assert not found.lost[k] and run.completed


def test_an_arm_that_falls_scores_next_to_nothing():
    class Nothing:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.zeros((len(observation), 2)), None

    found = score._score_of(Nothing(), SMALL)
    assert found.lost.all() and found.S.max() < 0.1


def test_the_set_is_the_versions_own_and_no_training_draws_it():
    again, other = score._held_out("test", each=2), score._held_out("next", each=2)
    assert again.references == SMALL.references and again.arms == SMALL.arms
    assert not set(other.references) & set(SMALL.references)
    assert not set(SMALL.references) & set(reference_family(ArmParameters(), 256))
    kinds = [(d.tip_force is not None, d.payload.mass > 0, d.encoder_noise is not None) for d in SMALL.disturbances]
    assert kinds == [*[(False,) * 3] * 2, *[(True, False, False)] * 4, *[(False, True, True)] * 2]


def test_the_command_prints_anchors_and_writes_the_file(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(score, "_held_out", lambda: SMALL)
    out = tmp_path / "score.json"
    text = printed(capsys, "score", "--policy", "fuzzy-4-tip", "computed-torque", "--out", out)
    document = json.loads(out.read_text())
    assert document["policies"]["computed-torque"]["N"] == 0.0
    assert document["anchors"]["learned-observer"]["N"] == 100.0
    assert "fuzzy-4-tip" in text and "over 2 policies: mean score N" in text and "worst N 0.0" in text
