"""The quick evaluation of a training is that of ``fuzzyarm evaluate``."""

import gymnasium as gym
import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.rl_baselines._case_evaluation import evaluate_cases


def test_the_quick_evaluation_finds_what_fuzzyarm_evaluate_finds():
    from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate

    found = evaluate_cases(load_policy("fuzzy-4", allow_unproven=True))
    for row in evaluate(EvaluationConfig(policies=("fuzzy-4",))).rows:
        case = row["case"]
        assert found[f"{case}_max_mm"] == pytest.approx(row["tip_error_max_mm"], rel=1e-9)
        assert found[f"{case}_rms_mm"] == pytest.approx(row["tip_error_rms_mm"], rel=1e-9)
        assert found[f"{case}_share"] == 1.0


def test_the_quick_evaluation_of_an_episode_that_ends_early_is_of_that_episode_alone():
    class ThrowsTheFirst:
        """Fuzzy-4, but at full torque in Case 1."""

        control_period = 1e-3
        law = load_policy("fuzzy-4", allow_unproven=True)

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            action, state = self.law.predict(observation, state, episode_start)
            action[0] = [500.0, 250.0]
            return action, state

    env, errors, terminated = gym.make("FuzzyArm-v0"), [], False
    env.reset(seed=0)
    while not terminated:
        _, _, terminated, _, info = env.step(np.array([500.0, 250.0]))
        errors.append(1e3 * info["tip_error"])
    found, untouched = evaluate_cases(ThrowsTheFirst()), evaluate_cases(ThrowsTheFirst.law)
    assert found["nominal_max_mm"] == pytest.approx(max(errors), rel=1e-12)
    assert found["nominal_rms_mm"] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-12)
    assert found["nominal_share"] == pytest.approx(len(errors) / 1500, abs=1e-9)
    assert all(found[name] == untouched[name] for name in found if not name.startswith("nominal"))
