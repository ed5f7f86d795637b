"""PPO of rsl_rl: python examples/train_rsl_rl.py [steps] writes rsl_rl.onnx  (pip install rsl-rl-lib onnx)."""
# ruff: noqa: E402  a wrong number is refused before the libraries are imported

import argparse

LANES, HOLDS = 256, 24  # of a rollout
parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("steps", nargs="?", type=int, default=1_800_000, help="at least; default: %(default)s")
parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
parser.add_argument("--device", help="cpu or cuda, where arms step as tensors; default: the compiled batch, in NumPy")
if (given := parser.parse_args()).steps < 1:
    parser.error(f"steps = {given.steps} is out of range; allowed: 1, 2, 3, ...")

import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnVectorEnv
from fuzzyarm.rl_baselines.torch_learn import TorchFuzzyArmLearn


class Arms(VecEnv):
    """A batch of arms behind rsl_rl's interface."""

    def __init__(self, envs: FuzzyArmLearnVectorEnv | TorchFuzzyArmLearn, device: str) -> None:
        self.envs, self.device, self.cfg = envs, device, {}
        self.num_envs, self.num_actions = envs.num_envs, envs.single_action_space.shape[0]
        self.episode_length_buf = torch.zeros(envs.num_envs, dtype=torch.long, device=device)
        (self.seen, _), self.max_episode_length = envs.reset(seed=given.seed), 1000  # 2 s in holds of 2 ms

    def get_observations(self) -> TensorDict:
        """Return what the policy sees."""
        return TensorDict({"policy": torch.as_tensor(self.seen)}, batch_size=[self.num_envs])

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict]:
        """Step every lane."""
        self.seen, *numbers, info = self.envs.step(actions)
        reward, terminated, truncated = map(torch.as_tensor, numbers)
        self.episode_length_buf = torch.where(over := terminated | truncated, 0, self.episode_length_buf + 1)
        self.tip_error = 1e3 * float(info["tip_error"].mean())
        return self.get_observations(), reward.float(), over.long(), {"time_outs": truncated}


network = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "elu", "obs_normalization": True}
settings = {
    "num_steps_per_env": HOLDS, "save_interval": 1000, "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
    "actor": {**network, "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.4}},
    "critic": network, "algorithm": {"class_name": "PPO", "gamma": 0.98, "entropy_coef": 0.0},
}  # fmt: skip
torch.set_num_threads(1), torch.manual_seed(given.seed)
device, envs = given.device or "cpu", FuzzyArmLearnVectorEnv(LANES)
if given.device:
    envs = TorchFuzzyArmLearn(LANES, device=device, compiled=device != "cpu")
runner = OnPolicyRunner(arms := Arms(envs, device), settings, log_dir=None, device=device)
for steps in range(0, given.steps, LANES * HOLDS):
    runner.learn(1)
    print(f"{steps + LANES * HOLDS:9,} steps, mean tip error {arms.tip_error:.1f} mm", flush=True)
model = runner.alg.get_policy().as_onnx(verbose=False).cpu().eval()
torch.onnx.export(model, model.get_dummy_inputs(), "rsl_rl.onnx", dynamo=False)
