"""PPO in one file of plain torch, in the style of CleanRL, on a batch of arms in tensors; on a GPU if there is one.

python examples/train_torch.py [steps]

Prints the mean tip error [mm] of every rollout, exploration included, and how many episodes left the domain. In 45 s
on one core 400,000 steps take it from 800 mm to 8.5 mm (seeds 1 and 2: 6.4 and 7.3 mm). Torques are held for 10 ms, not
the 1 ms at which `fuzzyarm evaluate` compares policies, and nothing is saved. At the end an episode without exploration
is run: after 60 s its mean error is 0.83 to 1.18 mm (benchmarks/plant_gradients.py at commit 2839bc83). The real
trainer is `fuzzyarm train ppo`.
"""

import argparse
import math
import time

import torch
from torch import Tensor, nn
from torch.distributions import Normal

from fuzzyarm.envs.observation import _SIZE as SIZE
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

LANES, ROLLOUT = 128, 150  # a rollout is one episode of every arm, so that each update sees the whole path
EPOCHS, MINIBATCHES, CLIP, GAMMA, GAE_LAMBDA, LEARNING_RATE = 4, 16, 0.2, 0.98, 0.95, 1e-3
REWARD_SCALE = 0.1  # returns are below 1 / (1 - GAMMA) = 50; scaled, they are near the outputs of a new network


def features(observation: Tensor) -> Tensor:
    """Return the tracking errors of the motors and the reference, scaled to a magnitude of about 1."""
    o = observed(observation)
    errors = (10.0 * (o.q_reference - o.q_motor), o.dq_reference - o.dq_motor)
    return torch.cat([*errors, o.q_reference, 0.2 * o.dq_reference, 0.03 * o.ddq_reference], dim=-1)


def network(outputs: int, last_gain: float) -> nn.Sequential:
    """Return a network with two hidden layers and orthogonal initial weights."""
    layers = [nn.Linear(SIZE, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]
    for layer, gain in zip(layers[::2], (2**0.5, 2**0.5, last_gain), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


def tip_error() -> float:
    """Run one episode from the paper's start without exploration and return its mean tip error [mm]."""
    arm, errors, done = TorchFuzzyArm(1, device=device, compiled=False, control_period=0.01, substep=1e-3), [], False
    with torch.no_grad():
        observation, _ = arm.reset(seed=0)
        while not done:
            observation, _, terminated, truncated, info = arm.step(
                actor(features(observation)).clip(-1.0, 1.0) * torque
            )
            errors.append(1e3 * info["tip_error"].item())
            done = bool(terminated | truncated)
    return sum(errors) / len(errors)


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("steps", nargs="?", type=int, default=400_000, help="at least; default: %(default)s")
parser.add_argument("--seconds", type=float, default=math.inf, help="of processor time to learn; default: no limit")
parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
arguments = parser.parse_args()
steps = arguments.steps
if steps < 1:
    parser.error(f"steps = {steps} is out of range; allowed: 1, 2, 3, ...")

torch.set_num_threads(1)  # for networks this small more threads are not faster
torch.manual_seed(arguments.seed)
device = "cuda" if torch.cuda.is_available() else "cpu"
# Compiling takes longer than this whole training on a CPU; sub-steps of 1 ms cost micrometres of accuracy.
envs = TorchFuzzyArm(LANES, device=device, compiled=device == "cuda", control_period=0.01, substep=1e-3)
torque = torch.tensor(envs.single_action_space.high, dtype=envs.dtype, device=device)  # N m, at action 1
actor, critic = network(JOINTS, 0.01).to(device), network(1, 1.0).to(device)
log_std = nn.Parameter(torch.full((JOINTS,), -1.0, device=device))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimizer = torch.optim.Adam(parameters, lr=LEARNING_RATE, eps=1e-5)

begin = time.process_time()
seen = features(envs.reset(seed=0)[0])
for update in range(1, -(-steps // (LANES * ROLLOUT)) + 1):
    rollout, tip_errors, left = [], [], 0
    with torch.no_grad():
        for _ in range(ROLLOUT):
            policy = Normal(actor(seen), log_std.exp())
            action = policy.sample()
            observation, reward, terminated, truncated, info = envs.step(action.clip(-1.0, 1.0) * torque)
            # Bootstrapping: an episode that ran out of time would have earned more, a terminated one would not.
            after = torch.where(terminated, 0.0, critic(features(info["final_obs"])).squeeze(-1))
            value, target = critic(seen).squeeze(-1), REWARD_SCALE * reward + GAMMA * after
            rollout.append((seen, action, policy.log_prob(action).sum(-1), value, target, terminated | truncated))
            tip_errors.append(info["tip_error"])
            left += terminated.sum()
            seen = features(observation)
        inputs, actions, log_probs, values, targets, ended = map(torch.stack, zip(*rollout, strict=True))
        advantages, advantage = torch.empty_like(values), torch.zeros_like(values[0])
        for t in reversed(range(ROLLOUT)):
            advantage = targets[t] - values[t] + GAMMA * GAE_LAMBDA * torch.where(ended[t], 0.0, advantage)
            advantages[t] = advantage
        samples = [part.flatten(0, 1) for part in (inputs, actions, log_probs, advantages, advantages + values)]

    for _ in range(EPOCHS):
        for chosen in torch.randperm(LANES * ROLLOUT, device=device).chunk(MINIBATCHES):
            inputs, actions, log_probs, advantages, returns = (part[chosen] for part in samples)
            ratio = (Normal(actor(inputs), log_std.exp()).log_prob(actions).sum(-1) - log_probs).exp()
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
            gain = torch.min(ratio * advantages, ratio.clip(1.0 - CLIP, 1.0 + CLIP) * advantages).mean()
            loss = 0.5 * (critic(inputs).squeeze(-1) - returns).square().mean() - gain
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimizer.step()

    error = 1e3 * torch.stack(tip_errors).mean().item()
    print(f"{update * LANES * ROLLOUT:>9} steps: mean tip error {error:.1f} mm, {int(left)} episodes left the domain")
    if time.process_time() - begin > arguments.seconds:
        break
print(f"after {update * LANES * ROLLOUT} steps without exploration: mean tip error {tip_error():.2f} mm")
