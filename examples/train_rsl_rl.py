"""PPO of rsl_rl on `FuzzyArmLearn-v0`: python examples/train_rsl_rl.py [updates]  (pip install rsl-rl-lib)."""

import sys
from typing import Any

import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnVectorEnv


class Arms(VecEnv):
    """The compiled batch behind rsl_rl's interface; on a GPU, `TorchFuzzyArmLearn` steps without a copy."""

    def __init__(self, lanes: int) -> None:
        self.envs = FuzzyArmLearnVectorEnv(lanes)
        self.num_envs, self.num_actions = lanes, self.envs.single_action_space.shape[0]
        self.max_episode_length = 1000  # 2 s in holds of 2 ms
        self.episode_length_buf, self.device, self.cfg = torch.zeros(lanes, dtype=torch.long), "cpu", {}
        self.seen, _ = self.envs.reset(seed=0)

    def get_observations(self) -> TensorDict:
        """Return what is seen now."""
        return TensorDict({"policy": torch.from_numpy(self.seen)}, batch_size=[self.num_envs])

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Step every lane."""
        self.seen, reward, terminated, truncated, info = self.envs.step(actions.numpy())
        over = torch.from_numpy(terminated | truncated)
        self.episode_length_buf = torch.where(over, 0, self.episode_length_buf + 1)
        log = {"/tip_error_mm": 1e3 * float(info["tip_error"].mean())}
        extras = {"time_outs": torch.from_numpy(truncated), "log": log}
        return self.get_observations(), torch.from_numpy(reward).float(), over.long(), extras


network = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "elu", "obs_normalization": True}
noise = {"class_name": "GaussianDistribution", "init_std": 0.4, "std_type": "scalar"}
settings = {
    "num_steps_per_env": 24, "save_interval": 1000, "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
    "actor": {**network, "distribution_cfg": noise}, "critic": network,
    "algorithm": {
        "class_name": "PPO", "num_learning_epochs": 5, "num_mini_batches": 4, "learning_rate": 1e-3, "gamma": 0.98,
        "schedule": "adaptive", "desired_kl": 0.01, "lam": 0.95, "entropy_coef": 0.0, "clip_param": 0.2,
        "value_loss_coef": 1.0, "use_clipped_value_loss": True, "max_grad_norm": 1.0,
        "rnd_cfg": None, "symmetry_cfg": None,
    },
}  # fmt: skip
torch.set_num_threads(1)
runner = OnPolicyRunner(Arms(256), settings, log_dir=None, device="cpu")
runner.learn(int(sys.argv[1]) if len(sys.argv) > 1 else 300)
