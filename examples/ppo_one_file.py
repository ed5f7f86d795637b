"""Proximal policy optimisation in one file: torch, the native batch, nothing else.

python examples/ppo_one_file.py --seed 0 --minutes 10 --out my-ppo
fuzzyarm score --policy my-ppo

The network commands torques through a low-pass filter of 10 ms: unfiltered noise of single holds hardly moves the arm,
and the filter's output, which is observed, tells the load. In training alone the critic sees the plant and the load.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import nn

from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.network import Network
from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnVectorEnv

LANES, STEPS, BATCH, EPOCHS = 256, 32, 512, 2
RATE, GAMMA, LAMBDA, CLIP, WIDTH = 1e-3, 0.98, 0.95, 0.2, 64
LOG_STD = -0.5  # of the actions, at first
FEATURES = FeatureDefinition(4, 4, error_scale=5e-3, rate_scale=0.1, integral_scale=5e-4, compression=1.5)
ACTION = ActionDefinition((500.0, 250.0), smoothing_time=0.01)

SEEN = {"tip", "tip_reference", "q_motor", "q_link", "dq_motor", "dq_link", "external_force"}


def plant(info: dict[str, np.ndarray], lanes: np.ndarray | slice = slice(None)) -> np.ndarray:
    """What no sensor measures, for the critic: the tip's error, bending, force and draws (lanes, 15)."""
    seen = {name: value[lanes] for name, value in info.items() if name in SEEN or name.startswith("drawn_")}
    parts = [
        np.arcsinh((seen["tip"] - seen["tip_reference"]) / 1e-4) / 4.0,
        100.0 * (seen["q_motor"] - seen["q_link"]),
        seen["dq_motor"] - seen["dq_link"],
        seen["external_force"] / 200.0,
        *(10.0 * (seen[f"drawn_{name}"] - 1.0) for name in ("mass", "stiffness")),
        2.0 * (seen["drawn_dry_friction"] - 1.0),
        np.stack([seen["drawn_payload"] / 5.0, seen["drawn_force"]], axis=1),
    ]
    return np.hstack(parts).astype(np.float32)


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
    envs = FuzzyArmLearnVectorEnv(LANES, features=FEATURES, action=ACTION, threads=1)
    size, joints = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    log_std = nn.Parameter(torch.full((joints,), LOG_STD))
    observation, info = envs.reset(seed=1000 * (seed + 1))
    hidden = plant(info)
    actor, critic = network(size, joints, 0.01), network(size + hidden.shape[1], 1, 1.0)
    parameters = [*actor.parameters(), *critic.parameters(), log_std]
    optimiser = torch.optim.Adam(parameters, lr=RATE, eps=1e-5, fused=True)
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
                last = np.hstack([last, plant(info["final_info"], np.flatnonzero(truncated))])
                with torch.no_grad():
                    value[truncated] = critic(torch.from_numpy(last))[:, 0].numpy()
            seen, likely = np.hstack([observation, hidden]), (-0.5 * noise**2 - np.log(std)).sum(1)
            for name, one in zip(rows, (seen, action, likely, (1 - GAMMA) * reward, over, value), strict=True):
                rows[name].append(one)
            observation, hidden = following, plant(info)
            errors.append(info["tip_error"])
        steps += LANES * STEPS
        x, a, lp, r, over, bootstrap = (np.stack(one).astype(np.float32) for one in rows.values())
        with torch.no_grad():
            everything = torch.from_numpy(np.concatenate([*x, np.hstack([observation, hidden])]))
            v = critic(everything)[:, 0].numpy().reshape(STEPS + 1, LANES)
        advantage, later = np.zeros_like(r), 0.0
        for t in reversed(range(STEPS)):
            follows = np.where(over[t], bootstrap[t], v[t + 1])
            later = r[t] + GAMMA * follows - v[t] + GAMMA * LAMBDA * np.where(over[t], 0.0, later)
            advantage[t] = later
        inputs, target = everything[:-LANES], torch.from_numpy((advantage + v[:-1]).ravel())
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        taken, before, gain = (torch.from_numpy(one.reshape(STEPS * LANES, -1)) for one in (a, lp, advantage))
        for _ in range(EPOCHS):
            for part in torch.randperm(STEPS * LANES).split(BATCH):
                z = (taken[part] - actor(inputs[part, :size])) * (-log_std).exp()
                ratio = ((-0.5 * z**2 - log_std).sum(1) - before[part, 0]).exp()
                surrogate = torch.min(ratio * gain[part, 0], ratio.clip(1 - CLIP, 1 + CLIP) * gain[part, 0]).mean()
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
    parser.add_argument("--minutes", type=float, default=10.0, help="of processor time")
    parser.add_argument("--out", type=Path, default=Path("my-ppo"))
    given = parser.parse_args()
    train(given.seed, 60.0 * given.minutes).save(given.out)
    print(f"written to {given.out}: fuzzyarm score --policy {given.out}")
