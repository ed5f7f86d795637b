"""TD3+BC in one file: a policy learned from the rewards of a data set, kept near what the data did.

fuzzyarm dataset --out sets --level mixed && python examples/offline_td3_bc.py sets/fuzzyarm/mixed-nominal-v0

Fujimoto and Gu, A Minimalist Approach to Offline Reinforcement Learning (2021): TD3 on a fixed data set, whose actor
maximises Q / mean |Q| with a weight, less the squared distance from the data's actions. Here that distance, and the
noise of the target's action, count in units of the noise in the data: a hundredth of the largest torque matters to
this arm. Features, test and score are those of clone_policy.py; docs/tutorials/datasets.md has the scores.
"""

import copy
import time

import numpy as np
import torch
from clone_policy import LIMIT, Cloned, arguments_of, instant, network, scored, with_past
from torch import nn

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.eval.dataset.store import provenance_of

BATCH, LEARNING_RATE, GAMMA, TAU, WEIGHT = 256, 3e-4, 0.98, 5e-3, 2.5
NOISE, LARGEST_NOISE, DELAY = 1.0, 2.5, 2  # of the target's action, in units; critic updates between two of the actor
SMALLEST_UNIT = 1e-3


def transitions(dataset):
    """Return features, actions in [-1, 1], rewards, features after the step, and 1 where the episode went on."""
    parts = []
    for episode in dataset.iterate_episodes():
        seen = with_past(instant(episode.observations))
        went_on = 1.0 - episode.terminations.astype(np.float32)  # a reference followed to its end is no failure
        parts.append((seen[:-1], episode.actions / LIMIT.numpy(), episode.rewards, seen[1:], went_on))
    return [torch.from_numpy(np.concatenate(part)).float() for part in zip(*parts, strict=True)]


def main() -> None:
    """Learn, and print the score."""
    arguments = arguments_of(__doc__.splitlines()[0])
    data, provenance = transitions(arguments.dataset), provenance_of(arguments.dataset)
    unit = max(provenance["settings"]["noise"], SMALLEST_UNIT)
    mean, std = data[0].mean(0), data[0].std(0) + 1e-3
    data[0], data[3] = (data[0] - mean) / std, (data[3] - mean) / std
    size = data[0].shape[1]
    actor, critics = network(size, JOINTS), [network(size + JOINTS, 1) for _ in range(2)]
    slow_actor, slow_critics = copy.deepcopy(actor), copy.deepcopy(critics)
    actor_optimizer = torch.optim.Adam(actor.parameters(), lr=LEARNING_RATE)
    critic_optimizer = torch.optim.Adam([p for critic in critics for p in critic.parameters()], lr=LEARNING_RATE)
    begin, updates = time.process_time(), 0
    while time.process_time() - begin < arguments.seconds:
        rows = torch.randint(len(data[0]), (BATCH,))
        seen, action, reward, after, went_on = (part[rows] for part in data)
        with torch.no_grad():
            noise = unit * (NOISE * torch.randn_like(action)).clip(-LARGEST_NOISE, LARGEST_NOISE)
            following = torch.cat([after, (torch.tanh(slow_actor(after)) + noise).clip(-1.0, 1.0)], dim=-1)
            target = reward + GAMMA * went_on * torch.min(*(critic(following)[:, 0] for critic in slow_critics))
        loss = sum(nn.functional.mse_loss(critic(torch.cat([seen, action], -1))[:, 0], target) for critic in critics)
        critic_optimizer.zero_grad()
        loss.backward()
        critic_optimizer.step()
        updates += 1
        if updates % DELAY:
            continue
        chosen = torch.tanh(actor(seen))
        value = critics[0](torch.cat([seen, chosen], dim=-1))
        pull = nn.functional.mse_loss(chosen, action) / unit**2
        actor_optimizer.zero_grad()
        (pull - WEIGHT * value.mean() / value.abs().mean().detach()).backward()
        actor_optimizer.step()
        with torch.no_grad():
            for slow, fast in zip((slow_actor, *slow_critics), (actor, *critics), strict=True):
                for old, new in zip(slow.parameters(), fast.parameters(), strict=True):
                    old.lerp_(new, TAU)
    print(f"{len(data[0])} samples, {updates} updates")
    whole = nn.Sequential(Standardised(mean, std), actor)
    print(f"TD3+BC: {scored(Cloned(whole), provenance)}")


class Standardised(nn.Module):
    """(x - mean)/std."""

    def __init__(self, mean, std):
        """Keep both."""
        super().__init__()
        self.mean, self.std = mean, std

    def forward(self, x):
        """Return the features in units of their spread."""
        return (x - self.mean) / self.std


if __name__ == "__main__":
    main()
