"""Proximal policy optimisation in one file: torch, the native batch, nothing else.

python examples/ppo_one_file.py --seed 0 --minutes 3 --out my-ppo
fuzzyarm score --policy my-ppo
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import nn

from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.network import Network
from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnVectorEnv

LANES, STEPS, BATCH, EPOCHS = 64, 32, 64, 10
RATE, GAMMA, LAMBDA, CLIP, WIDTH, HISTORY = 3e-4, 0.99, 0.95, 0.2, 64, 0
LOG_STD = 0.0  # of the actions, at first


def network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    """Two hidden layers of tanh, with orthogonal weights."""
    layers = [nn.Linear(inputs, WIDTH), nn.Tanh(), nn.Linear(WIDTH, WIDTH), nn.Tanh(), nn.Linear(WIDTH, outputs)]
    for layer in layers[::2]:
        nn.init.orthogonal_(layer.weight, gain if layer is layers[-1] else 2**0.5)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


def bundle_of(envs: FuzzyArmLearnVectorEnv, actor: nn.Sequential, seed: int) -> PolicyBundle:
    """The actor as the package's own kind of policy, which needs no torch."""
    layers = [layer for layer in actor if isinstance(layer, nn.Linear)]
    weights, biases = (
        tuple(getattr(one, name).detach().numpy().copy() for one in layers) for name in ("weight", "bias")
    )
    size = envs.features.size
    network = Network(np.zeros(size), np.ones(size), 10.0, weights, biases)  # without a normaliser of features
    return PolicyBundle(envs.features, envs.action, network, seed=seed)


def train(seed: int, seconds: float, report: Callable[[float, int, float], object] | None = None) -> PolicyBundle:
    """Train for so much processor time; `report` gets the time [s], the steps and the median tip error [mm]."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    envs = FuzzyArmLearnVectorEnv(LANES, history=HISTORY, threads=1)
    size, joints = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    actor, critic = network(size, joints, 0.01), network(size, 1, 1.0)
    log_std = nn.Parameter(torch.full((joints,), LOG_STD))
    parameters = [*actor.parameters(), *critic.parameters(), log_std]
    optimiser = torch.optim.Adam(parameters, lr=RATE, eps=1e-5)
    observation, _ = envs.reset(seed=1000 * (seed + 1))
    began, told, steps = time.process_time(), 0.0, 0
    while (spent := time.process_time() - began) < seconds:
        share = spent / seconds
        for group in optimiser.param_groups:
            group["lr"] = RATE * max(0.02, 1.0 - share)
        rows: dict[str, list[np.ndarray]] = {name: [] for name in ("x", "a", "lp", "r", "over", "value")}
        std, errors = log_std.exp().detach().numpy(), []
        for _ in range(STEPS):
            with torch.no_grad():
                mean = actor(torch.from_numpy(observation)).numpy()
            noise = rng.standard_normal(mean.shape).astype(np.float32)
            action = mean + std * noise
            following, reward, terminated, truncated, info = envs.step(action)
            over, value = terminated | truncated, np.zeros(LANES, dtype=np.float32)
            if truncated.any():  # the motion goes on where only the clock has ended the episode
                last = np.stack(info["final_obs"][truncated])
                with torch.no_grad():
                    value[truncated] = critic(torch.from_numpy(last))[:, 0].numpy()
            likely = (-0.5 * noise**2 - np.log(std)).sum(1)
            for name, one in zip(rows, (observation, action, likely, (1 - GAMMA) * reward, over, value), strict=True):
                rows[name].append(one)
            observation = following
            errors.append(info["tip_error"])
        steps += LANES * STEPS
        x, a, lp, r, over, bootstrap = (np.stack(one).astype(np.float32) for one in rows.values())
        with torch.no_grad():
            everything = torch.from_numpy(np.concatenate([x.reshape(-1, size), observation]))
            v = critic(everything)[:, 0].numpy().reshape(STEPS + 1, LANES)
        advantage, later = np.zeros_like(r), 0.0
        for t in reversed(range(STEPS)):
            follows = np.where(over[t], bootstrap[t], v[t + 1])
            later = r[t] + GAMMA * follows - v[t] + GAMMA * LAMBDA * np.where(over[t], 0.0, later)
            advantage[t] = later
        inputs, target = torch.from_numpy(x.reshape(-1, size)), torch.from_numpy((advantage + v[:-1]).ravel())
        taken, before, gain = (torch.from_numpy(one.reshape(STEPS * LANES, -1)) for one in (a, lp, advantage))
        for _ in range(EPOCHS):
            for part in torch.randperm(STEPS * LANES).split(BATCH):
                z = (taken[part] - actor(inputs[part])) * (-log_std).exp()
                ratio = ((-0.5 * z**2 - log_std).sum(1) - before[part, 0]).exp()
                one = gain[part, 0]
                one = (one - one.mean()) / (one.std() + 1e-8)
                surrogate = torch.min(ratio * one, ratio.clip(1 - CLIP, 1 + CLIP) * one).mean()
                loss = 0.5 * (critic(inputs[part])[:, 0] - target[part]).square().mean() - surrogate
                optimiser.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(parameters, 0.5)
                optimiser.step()
        if spent >= told:
            told += 10.0
            median = 1e3 * float(np.median(np.concatenate(errors)))
            print(f"{spent:5.0f} s {steps:9,} steps, median tip error {median:.3f} mm", flush=True)
            if report is not None:
                report(spent, steps, median)
    return bundle_of(envs, actor, seed)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=3.0, help="of processor time")
    parser.add_argument("--out", type=Path, default=Path("my-ppo"))
    given = parser.parse_args()
    train(given.seed, 60.0 * given.minutes).save(given.out)
    print(f"written to {given.out}: fuzzyarm score --policy {given.out}")
