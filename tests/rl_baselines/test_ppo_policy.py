"""A value function that sees the plant, smooth actions, exact resume."""

import dataclasses

import numpy as np
import pytest
import torch
from support.bundles import answering
from support.trainings import SMALL_TRAINING, resumed_to_the_bit

from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.rl_baselines._ppo_policy import NOISE
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.training import Training

SMALL = PPOConfig(**SMALL_TRAINING, asymmetric_critic=True)


@pytest.mark.slow
def test_it_resumes_to_the_bit_and_ships_only_what_sensors_tell(tmp_path):
    whole = resumed_to_the_bit(SMALL, tmp_path, 96)
    network, model = PolicyBundle.load(tmp_path / "whole" / "policy").network, whole.algorithm
    seen = SMALL.features.size
    assert network.sizes[0] == seen < model.model.observation_space.shape[0]
    features = np.random.default_rng(0).normal(size=(20, model.model.observation_space.shape[0]))
    action = answering(network)(np.ascontiguousarray(features[:, :seen]))
    expected, _ = model.model.predict(features.astype(np.float32), deterministic=True)
    np.testing.assert_allclose(action, expected, atol=2e-6)
    assert np.abs(action).max() > 0.0


@pytest.mark.slow
def test_the_critic_alone_sees_the_plant(tmp_path):
    training = Training(SMALL, tmp_path)
    policy, size = training.algorithm.model.policy, training.algorithm.model.observation_space.shape[0]
    one = torch.randn(5, size)
    other = one.clone()
    other[:, SMALL.features.size :] += 1.0
    assert torch.equal(policy._mean(one), policy._mean(other))
    assert not torch.equal(policy.predict_values(one), policy.predict_values(other))


@pytest.mark.slow
def test_smoothness_lowers_how_much_actions_change_with_small_noise(tmp_path):
    def slope(smoothness):
        config = dataclasses.replace(SMALL, smoothness=smoothness, total_timesteps=960, learning_rate=0.01)
        training = Training(config, tmp_path / f"{smoothness}")
        training.run()
        assert (training.rows[-1].get("smoothness_loss", 0.0) > 0.0) == (smoothness > 0.0)
        policy = training.algorithm.model.policy
        torch.manual_seed(0)
        features = torch.randn(400, training.algorithm.model.observation_space.shape[0])
        with torch.no_grad():
            apart = policy._mean(features + NOISE * torch.randn_like(features)) - policy._mean(features)
        return float((apart**2).mean())

    assert slope(1e5) < 0.5 * slope(0.0)
