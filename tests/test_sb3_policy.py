"""The example that ranks a zip of stable-baselines3: it acts as the model did in the environment that it learned in."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers.vector import RescaleAction
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from fuzzyarm import ArmParameters
from fuzzyarm.cli import main
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

NAME = "examples.sb3_policy:factory"


@pytest.fixture
def saved(tmp_path, monkeypatch):
    """A model that has learned for a moment at 2 ms, its files, and the environment variables that name them."""
    arms = gym.make_vec("fuzzyarm:FuzzyArm-v0", num_envs=2, control_period=2e-3)
    envs = VecNormalize(StableBaselinesVecEnv(RescaleAction(arms, -1, 1)))
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=64, n_epochs=1, seed=0, device="cpu")
    model.learn(64)
    model.save(tmp_path / "model.zip")
    envs.save(str(tmp_path / "normaliser.pkl"))
    monkeypatch.setenv("SB3_POLICY", str(tmp_path / "model.zip"))
    monkeypatch.setenv("SB3_NORMALISER", str(tmp_path / "normaliser.pkl"))
    monkeypatch.setenv("SB3_PERIOD", "0.002")
    monkeypatch.chdir(Path(__file__).parents[1])
    return model, envs


def test_it_acts_as_in_the_training(saved):
    from examples.sb3_policy import factory

    model, envs = saved
    policy, env = factory(1e-3, ArmParameters()), FuzzyArmEnv()
    observation, _ = env.reset(seed=0)
    state = None
    for step in range(6):
        torque, state = policy.predict(observation, state)
        if step % 2 == 0:
            action, _ = model.predict(envs.normalize_obs(observation), deterministic=True)
            expected = action * env.action_space.high
        np.testing.assert_allclose(torque, expected, rtol=1e-6)
        observation, *_ = env.step(torque)


def test_without_a_file_it_says_which_variable(saved, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("SB3_POLICY")
    assert main(["evaluate", "--policy", NAME, "--out", str(tmp_path / "out")]) == 2
    assert "set SB3_POLICY to the zip" in capsys.readouterr().err
