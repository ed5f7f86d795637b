"""The learning task ``FuzzyArmLearn-v0`` as a batch of arms in torch tensors."""

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor

from fuzzyarm.common import checks
from fuzzyarm.envs.observation import Observation, observed
from fuzzyarm.envs.physics.equations import chosen_arm
from fuzzyarm.envs.task import Termination
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.fuzzy_policy.laws.learned.definition import learning_features
from fuzzyarm.fuzzy_policy.laws.learned.features import Features, learning_action
from fuzzyarm.numbers.functions import flat, like
from fuzzyarm.rl_baselines.learning_task import BOUND, EARLY_END, RESOLUTION, learning_draws
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

__all__ = ["TorchFuzzyArmLearn"]


class TorchFuzzyArmLearn(TorchFuzzyArm):
    """A batch of ``FuzzyArmLearn-v0`` whose observations, actions and rewards are tensors on the CPU or a GPU.

    Observation, action, reward and episode ends are those of `fuzzyarm.rl_baselines.learning_task.FuzzyArmLearnEnv`:
    lane i of a batch that was reset with ``seed=s`` equals the single environment with seed s + i up to rounding. A
    lane that ends begins its next episode within the same step, as in `TorchFuzzyArm`. `info` has the entries of
    `TorchFuzzyArm`, with the last features as ``final_obs``, and ``lost`` (n,), whether the tip was farther than
    `early_end` from its reference.

    Args:
        num_envs: number of lanes.
        history: number of past errors and actions that are also observed, with the leaky integral of the error.
        early_end: tip error that ends an episode [m].
        arguments: those of `TorchFuzzyArm` except the control period, which is the 2 ms for which an action is held.
            Without a case, disturbance or reference an episode draws from `learning_draws`.

    Raises:
        TypeError, ValueError: see `TorchFuzzyArm`.
    """

    def __init__(self, num_envs: int, *, history: int = 0, early_end: float = EARLY_END, **arguments: Any) -> None:
        arm = chosen_arm(arguments.get("robot"), arguments.get("parameters"))
        self.early_end = checks.real("early_end", early_end, "m", low=RESOLUTION)
        action, features = learning_action(arm), learning_features(joints_of(arm), checks.whole("history", history))
        if {"case", "disturbance", "reference"}.isdisjoint(arguments):
            draws = {} if "randomisation" in arguments else {"randomisation": learning_draws(arm)}
            arguments = {"case": "machining", **draws, **arguments}
        super().__init__(num_envs, control_period=action.period, **arguments)
        self._arguments = {"num_envs": num_envs, "history": history, "early_end": early_end, **arguments}
        self._features = Features(features, action.period, arm)
        unit = np.ones(features.joints, dtype=np.float32)
        self.single_action_space = gym.spaces.Box(-unit, unit)
        self.single_observation_space = gym.spaces.Box(-BOUND, BOUND, (features.size,), np.float32)
        self._scale = torch.tensor(action.scale, dtype=self.dtype, device=self.device)
        self._memory = torch.zeros(self._features.memory_size, num_envs).to(self._scale)
        self._seen = torch.empty(0)  # the last observations (n, 5 joints), from the first reset on

    def __getstate__(self) -> dict[str, Any]:
        """Return what pickle stores: the arguments, and the state, memory and last observations of the lanes."""
        return {**super().__getstate__(), "remembered": (self._memory, self._seen)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Unpickle: build the batch from the arguments in `state`, then restore its lanes, memory and observations."""
        super().__setstate__(state)
        self._memory, self._seen = state["remembered"]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Begin an episode in every lane; return the features (n, size) and an empty info."""
        self._seen, info = super().reset(seed=seed, options=options)
        self._memory = torch.zeros_like(self._memory)
        return self._shown(self._seen), info

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Tensor]]:
        """Hold `action` (n, joints), fractions of the torque limits within ±1, for 2 ms; see `TorchFuzzyArm.step`."""
        given = torch.as_tensor(action, dtype=self.dtype, device=self.device).clip(-1.0, 1.0)
        torque = given * self._scale if given.shape[-1:] == self._scale.shape else given  # which super().step refuses
        after, _, terminated, truncated, info = super().step(torque)
        if len(self._memory):
            memory, seen = self._remembered(), _parts(self._seen)
            told = self._features.told(memory, seen)
            self._memory = torch.stack(flat(self._features.advance(memory, seen, told, tuple(given.t()))))
        final, self._seen = self._shown(info["final_obs"]), after
        self._memory = torch.where(terminated | truncated, 0.0, self._memory)
        kept = 1.0 - torch.log1p(info["tip_error"] / RESOLUTION) / np.log1p(self.early_end / RESOLUTION)
        info |= {"final_obs": final, "lost": info["reason"] == Termination.LOST}
        return self._shown(self._seen), torch.where(terminated, 0.0, kept), terminated, truncated, info

    def _remembered(self) -> Any:
        return like(self._features.memory, iter(self._memory))

    def _shown(self, observation: Tensor) -> Tensor:
        """Return the features (n, size) of observations (n, 5 joints) in float32."""
        memory, seen = self._remembered(), _parts(observation)
        out: list[Any] = [None] * self._features.size
        self._features.fill(memory, seen, self._features.told(memory, seen)[2], out=out)
        return torch.stack([number.to(torch.float32) for number in out], dim=-1).clip(-BOUND, BOUND)


def _parts(observation: Tensor) -> Observation:
    """Split observations of n lanes into parts, such as the motor angles: tuples with a tensor (n,) per joint."""
    return Observation(*(tuple(part.unbind(-1)) for part in observed(observation)))
