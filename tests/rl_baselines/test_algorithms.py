"""An algorithm from outside the package: one file, and the trainer trains, ships and resumes it."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
import torch
from support.trainings import resumed_to_the_bit

from fuzzyarm import load_policy
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.network import Network
from fuzzyarm.rl_baselines.algorithm import AlgorithmSpec
from fuzzyarm.rl_baselines.algorithms import ALGORITHMS, add_algorithm, algorithm_of, find_algorithm
from fuzzyarm.rl_baselines.algorithms.ppo import SPEC, PPOConfig
from fuzzyarm.rl_baselines.config import TrainingConfig


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchConfig(TrainingConfig):
    """Random search over the weights of a linear policy."""

    spread: float = 0.1
    """Standard deviation of a trial's weights."""


class RandomSearch:
    """Drives all lanes for some steps with random weights, and keeps those with the largest reward."""

    def __init__(self, config, envs):
        torch.manual_seed(config.seed)
        envs.seed(config.seed)
        self.config, self.envs, self.steps = config, envs, 0
        self.features = envs.reset()
        self.weight, self.best = torch.zeros(2, envs.observation_space.shape[0]), -np.inf

    def learn(self, after_update):
        while self.steps < self.config.total_timesteps:
            after_update(self.update())

    def update(self):
        trial, rewards = self.config.spread * torch.randn(self.weight.shape), []
        for _ in range(20):
            action = np.clip(self.features @ trial.numpy().T, -1.0, 1.0)
            self.features, reward, _, _ = self.envs.step(action)
            rewards.append(reward.mean())
            self.steps += self.config.lanes
        if np.mean(rewards) > self.best:
            self.weight, self.best = trial, float(np.mean(rewards))
        return {"mean_reward": float(np.mean(rewards))}

    def network(self):
        size = self.weight.shape[1]
        weights = (self.weight.numpy().astype(np.float32),)
        return Network(np.zeros(size), np.ones(size), 100.0, weights, (np.zeros(2, np.float32),))

    def state(self):
        return {"weight": self.weight, "best": self.best, "steps": self.steps, "features": self.features}

    def set_state(self, state):
        self.weight, self.best, self.steps = state["weight"], state["best"], state["steps"]
        self.features = state["features"].numpy()


SEARCH = AlgorithmSpec(
    name="random-search",
    title="random search",
    config=SearchConfig,
    presets={"small": SearchConfig(lanes=4, total_timesteps=800, checkpoint_interval=240)},
    create=RandomSearch,
    columns=("mean_reward",),
)


@pytest.fixture
def added():
    """The algorithm, registered until the test ends."""
    add_algorithm(SEARCH)
    yield SEARCH.presets["small"]
    del ALGORITHMS[SEARCH.name]


@pytest.mark.usefixtures("brief_evaluations")
def test_an_algorithm_from_outside_is_trained_shipped_and_resumed(added, tmp_path):
    resumed_to_the_bit(added, tmp_path, 400)
    lines = (tmp_path / "whole" / "curve.csv").read_text().splitlines()
    assert lines[0].startswith("steps,episode_reward,episode_length,tip_error_mm,mean_reward,nominal_max_mm,")
    assert len(lines) == 11
    bundle = PolicyBundle.load(tmp_path / "whole" / "policy")
    assert bundle.training["algorithm"] == "random search" and bundle.training["spread"] == 0.1
    assert set(bundle.versions) == {"fuzzyarm", "numpy", "gymnasium", "llvmlite"}
    action, _ = load_policy(tmp_path / "whole" / "policy").predict(np.ones(10))
    assert np.abs(action).max() > 1.0


def test_names_and_classes_of_settings_are_unique(added):
    assert find_algorithm("random-search") is algorithm_of(added) is SEARCH
    assert algorithm_of(PPOConfig()) is find_algorithm("ppo") is SPEC
    with pytest.raises(ValueError, match="there is an algorithm 'ppo' already"):
        add_algorithm(dataclasses.replace(SEARCH, name="ppo"))
    with pytest.raises(ValueError, match="SearchConfig holds the settings of 'random-search'; derive a class"):
        add_algorithm(dataclasses.replace(SEARCH, name="another"))


def test_what_is_not_registered_is_named():
    with pytest.raises(ValueError, match="unknown algorithm 'a2c'; choose from: ppo"):
        find_algorithm("a2c")
    with pytest.raises(ValueError, match="SearchConfig holds the settings of no known algorithm; call add_algorithm"):
        algorithm_of(SearchConfig())
