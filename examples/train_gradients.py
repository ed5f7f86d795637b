"""A policy learned by gradients through the arm itself: its steps are differentiable, so nothing has to be guessed.

python examples/train_gradients.py [steps]

Short windows of an episode are run with the policy, and the logarithm of the tip error is followed back through network
and arm, as in analytic policy gradients and SHAC, here without a critic: a window of 0.15 s sees what a torque does.
Torques are held for 10 ms as in train_torch.py, which learns the same task by PPO from rewards alone. In 60 s on one
core, after 10 to 35 s of compiling, the mean tip error is 0.42 to 0.54 mm, with PPO 0.83 to 1.18 mm; the command is
benchmarks/plant_gradients.py at commit 2839bc83. Nothing is saved.
"""

import argparse
import math
import time

import torch
from torch import Tensor, nn

from fuzzyarm.envs.observation import _SIZE as SIZE
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

LANES, WINDOW, HOLD = 16, 15, 10  # a window is 15 decisions, each held for 10 control steps of 1 ms
LEARNING_RATE, DECAY, LARGEST_GRADIENT, LENGTH = 3e-3, 0.995, 1.0, 1e-3


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
    """Run one episode from the paper's start and return its mean tip error [mm]."""
    arm, errors, done = TorchFuzzyArm(1, compiled=False, control_period=0.01, substep=1e-3), [], False
    with torch.no_grad():
        observation, _ = arm.reset(seed=0)
        while not done:
            action = torch.tanh(actor(features(observation))) * limit
            observation, _, terminated, truncated, info = arm.step(action)
            errors.append(1e3 * info["tip_error"].item())
            done = bool(terminated | truncated)
    return sum(errors) / len(errors)


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("steps", nargs="?", type=int, default=100_000, help="at least; default: %(default)s")
parser.add_argument("--seconds", type=float, default=math.inf, help="of processor time to learn; default: no limit")
parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
parser.add_argument("--eager", action="store_true", help="do not compile the arm")
arguments = parser.parse_args()
if arguments.steps < 1:
    parser.error(f"steps = {arguments.steps} is out of range; allowed: 1, 2, 3, ...")

torch.set_num_threads(1)  # for networks this small more threads are not faster
torch.manual_seed(arguments.seed)
# Without different starts all lanes would be alike, and the policy would know one line through its states.
spread = DomainRandomisation(angle=(-0.02, 0.02))
envs = TorchFuzzyArm(LANES, compiled=not arguments.eager, differentiable=True, substep=1e-3, randomisation=spread)
limit = torch.tensor(envs.single_action_space.high, dtype=envs.dtype)
actor = network(JOINTS, 0.01)
optimizer = torch.optim.Adam(actor.parameters(), lr=LEARNING_RATE)
schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, DECAY)
envs.reset()
envs.step(torch.zeros(LANES, JOINTS))[1].sum().backward()  # compiles the step and its gradient

(seen, _), begin, recent = envs.reset(seed=arguments.seed), time.process_time(), []
for update in range(1, -(-arguments.steps // (LANES * WINDOW)) + 1):
    loss = torch.zeros(())
    for _ in range(WINDOW):
        action = torch.tanh(actor(features(seen))) * limit
        for _ in range(HOLD):
            seen, _, _, _, info = envs.step(action)
            loss = loss + torch.log1p(info["tip_error"] / LENGTH).mean() / (WINDOW * HOLD)
        recent.append(1e3 * info["tip_error"].mean().item())
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(actor.parameters(), LARGEST_GRADIENT)
    optimizer.step()
    schedule.step()
    envs.detach()
    seen = seen.detach()
    if update % 10 == 0:  # an episode is ten windows
        print(f"{update * LANES * WINDOW:>9} steps: mean tip error {sum(recent) / len(recent):.1f} mm")
        recent.clear()
    if time.process_time() - begin > arguments.seconds:
        break
print(f"after {update * LANES * WINDOW} steps on the paper's circle: mean tip error {tip_error():.2f} mm")
