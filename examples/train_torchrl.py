"""PPO of TorchRL: python examples/train_torchrl.py [steps] writes torchrl.onnx  (pip install torchrl onnx)."""
# ruff: noqa: E402  a wrong number is refused before the libraries are imported

import argparse

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("steps", nargs="?", type=int, default=400_000, help="at least; default: %(default)s")
parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
if (given := parser.parse_args()).steps < 1:
    parser.error(f"steps = {given.steps} is out of range; allowed: 1, 2, 3, ...")

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

torch.manual_seed(given.seed)
torch.set_num_threads(1)
envs = GymWrapper(FuzzyArmLearnVectorEnv(LANES, autoreset_mode="Disabled"))
envs.set_seed(given.seed)
size, joints = envs.observation_spec["observation"].shape[-1], envs.action_spec.shape[-1]


def layers(outputs: int) -> nn.Sequential:
    """Two hidden layers of tanh."""
    return nn.Sequential(nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


body, value = layers(2 * joints), layers(1)
mean = TensorDictModule(nn.Sequential(body, NormalParamExtractor()), ["observation"], ["loc", "scale"])
actor = ProbabilisticActor(mean, in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True)
advantage = GAE(gamma=0.98, lmbda=0.95, value_network=(critic := ValueOperator(value)), average_gae=True)
loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_bonus=False)
optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
for k, batch in enumerate(Collector(envs, actor, frames_per_batch=LANES * STEPS, total_frames=given.steps)):
    with torch.no_grad():
        advantage(batch)
    flat = batch.reshape(-1)
    for part in (part for _ in range(EPOCHS) for part in torch.randperm(len(flat)).chunk(PARTS)):
        found = loss(flat[part])
        (found["loss_objective"] + found["loss_critic"]).backward()
        nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
        optimiser.step(), optimiser.zero_grad()
    if k % 20 == 0:
        print(f"{(k + 1) * LANES * STEPS:9,} frames, reward {batch['next', 'reward'].mean():.3f}", flush=True)

body[-1].weight.data, body[-1].bias.data = (
    body[-1].weight.data[:joints],
    body[-1].bias.data[:joints],
)  # without the scale
names = {"input_names": ["seen"], "dynamic_axes": {"seen": {0: "lanes"}}, "dynamo": False}
torch.onnx.export(nn.Sequential(body, nn.Tanh()), (torch.zeros(1, size),), "torchrl.onnx", **names)
