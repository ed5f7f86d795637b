"""PPO of TorchRL on `FuzzyArmLearn-v0`: python examples/train_torchrl.py [steps]  (pip install torchrl)."""
# ruff: noqa: E402  a wrong number is refused before the libraries are imported

import argparse

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("steps", nargs="?", type=int, default=400_000, help="at least; default: %(default)s")
FRAMES = parser.parse_args().steps
if FRAMES < 1:
    parser.error(f"steps = {FRAMES} is out of range; allowed: 1, 2, 3, ...")

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnVectorEnv

LANES, STEPS, EPOCHS, PARTS = 64, 32, 10, 8

torch.manual_seed(0)
torch.set_num_threads(1)
envs = GymWrapper(FuzzyArmLearnVectorEnv(LANES, autoreset_mode="Disabled"))
size, joints = envs.observation_spec["observation"].shape[-1], envs.action_spec.shape[-1]


def layers(outputs: int) -> list[nn.Module]:
    """Two hidden layers of tanh."""
    return [nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]


mean = TensorDictModule(nn.Sequential(*layers(2 * joints), NormalParamExtractor()), ["observation"], ["loc", "scale"])
actor = ProbabilisticActor(mean, in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True)
critic = ValueOperator(nn.Sequential(*layers(1)), in_keys=["observation"])
advantage = GAE(gamma=0.98, lmbda=0.95, value_network=critic, average_gae=True)
loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_bonus=False)
optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
collector = Collector(envs, actor, frames_per_batch=LANES * STEPS, total_frames=FRAMES)
for k, batch in enumerate(collector):
    with torch.no_grad():
        advantage(batch)
    flat = batch.reshape(-1)
    for _ in range(EPOCHS):
        for part in torch.randperm(len(flat)).chunk(PARTS):
            found = loss(flat[part])
            (found["loss_objective"] + found["loss_critic"]).backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            optimiser.step()
            optimiser.zero_grad()
    if k % 20 == 0:
        print(f"{(k + 1) * LANES * STEPS:9,} frames, reward {batch['next', 'reward'].mean():.3f}", flush=True)
