"""`TorchFuzzyArmLearn` as an environment of TorchRL: arms, observations and actions stay tensors on the device.

python examples/torchrl_tensors.py [--device cuda]  (pip install torchrl) checks it and times random actions. To learn,
put `Arms(64)` in place of the `GymWrapper` of train_torchrl.py.
"""

import argparse
import time

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, check_env_specs

from fuzzyarm.rl_baselines.torch_learn import TorchFuzzyArmLearn


class Arms(EnvBase):
    """A lane that ends begins its next episode within the step; TorchRL is shown that where it resets the lane."""

    def __init__(self, lanes: int, device: str = "cpu") -> None:
        super().__init__(device=device, batch_size=[lanes])
        self.arms = TorchFuzzyArmLearn(lanes, device=device, compiled=device != "cpu")  # compiling takes a minute
        size, joints = self.arms.single_observation_space.shape[0], self.arms.single_action_space.shape[0]
        flags = {name: Binary(1, (lanes, 1), device, torch.bool) for name in ("done", "terminated", "truncated")}
        self.observation_spec = Composite(observation=Unbounded((lanes, size), device), shape=[lanes])
        self.action_spec = Bounded(-1.0, 1.0, (lanes, joints), device)
        self.reward_spec, self.done_spec = Unbounded((lanes, 1), device), Composite(flags, shape=[lanes])
        self.next_seed, self.seen = 0, torch.empty(0)

    def _set_seed(self, seed: int | None) -> None:
        self.next_seed = seed

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDict:
        if tensordict is None or "_reset" not in tensordict:
            (self.seen, _), self.next_seed = self.arms.reset(seed=self.next_seed), None
        over = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
        flags = dict.fromkeys(("done", "terminated", "truncated"), over)
        return TensorDict({"observation": self.seen, **flags}, self.batch_size, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self.seen, reward, terminated, truncated, info = self.arms.step(tensordict["action"])
        numbers = {"reward": reward.float(), "done": terminated | truncated}
        numbers |= {"terminated": terminated, "truncated": truncated}
        columns = {name: number[:, None] for name, number in numbers.items()}
        return TensorDict({"observation": info["final_obs"], **columns}, self.batch_size, device=self.device)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu", help="default: %(default)s")
    arms = Arms(1024, parser.parse_args().device)
    check_env_specs(arms)
    begin, steps = time.perf_counter(), 300
    reward = arms.rollout(steps, break_when_any_done=False)["next", "reward"].mean().item()
    print(f"{1024 * steps / (time.perf_counter() - begin):,.0f} steps/s, mean reward of random actions {reward:.3f}")
