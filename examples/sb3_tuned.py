"""PPO of stable-baselines3 with settings that suit the learning task: a filtered torque and large batches.

python examples/sb3_tuned.py [--minutes 5] [--seed SEED] [--out my-tuned]
fuzzyarm score --policy my-tuned

The filter makes the exploration smooth, so that it moves the arm; its output is among the observations.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO

from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.network import Network
from fuzzyarm.rl_baselines.sb3_vec_env import learning_envs

FEATURES = FeatureDefinition(4, 4, error_scale=5e-3, rate_scale=0.1, integral_scale=5e-4, compression=1.5)
ACTION = ActionDefinition((500.0, 250.0), smoothing_time=0.01)
SETTINGS = {"n_steps": 32, "batch_size": 512, "n_epochs": 2, "gamma": 0.98, "policy_kwargs": {"log_std_init": -0.5}}


def train(seed, seconds, report=None):
    """Train for so much processor time; `report` gets the time [s], the steps and the tip error of episodes [mm]."""
    torch.set_num_threads(1)
    began, times = time.process_time(), [0.0]

    def watch(found, _):
        times.append(time.process_time() - began)
        ended = found["self"].ep_info_buffer
        if report is not None and ended and times[-1] // 10.0 > times[-2] // 10.0:
            report(times[-1], found["self"].num_timesteps, 1e3 * np.median([one["tip_error"] for one in ended]))
        return times[-1] < seconds

    def rate(_):
        return 1e-3 * max(0.02, 1.0 - times[-1] / seconds)

    envs = learning_envs(256, features=FEATURES, action=ACTION, threads=1)
    model = PPO("MlpPolicy", envs, learning_rate=rate, seed=seed, device="cpu", **SETTINGS)
    model.learn(10**9, callback=watch)
    layers = [*model.policy.mlp_extractor.policy_net[::2], model.policy.action_net]
    weights = tuple(layer.weight.detach().numpy() for layer in layers)
    biases = tuple(layer.bias.detach().numpy() for layer in layers)
    network = Network(np.zeros(FEATURES.size), np.ones(FEATURES.size), 10.0, weights, biases)
    return PolicyBundle(FEATURES, ACTION, network, seed=seed)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=5.0, help="of processor time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("my-tuned"))
    given = parser.parse_args()
    train(given.seed, 60.0 * given.minutes).save(given.out)
    print(f"written to {given.out}: fuzzyarm score --policy {given.out}")
