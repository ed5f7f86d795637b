"""The networks of PPO, with a privileged value function and a smoothness term in the loss."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

__all__ = ["NOISE", "GuidedPolicy", "PlantView"]

_TIP, _FORCE = 1e-4, 200.0  # m, N


class PlantView(VecEnvWrapper):
    """Arms whose observations end with unmeasured quantities for the value function, which is not shipped.

    These are asinh((p - p_d)/0.1 mm) for the tip p and its reference, asinh((q_b - q_a)/0.1 mrad) for link and motor
    angles, asinh(q̇_b/(10 mrad/s)), the tip force in units of 200 N, and the randomised quantities of the episode.
    """

    def __init__(self, venv: StableBaselinesVecEnv) -> None:
        self.venv = venv
        size = self._seen(venv.reset()).shape[1]
        super().__init__(venv, gym.spaces.Box(-np.inf, np.inf, (size,)))

    def reset(self) -> np.ndarray:
        """Begin an episode in every lane and return the observations (lanes, features)."""
        return self._seen(self.venv.reset())

    def step_wait(self) -> VecEnvStepReturn:
        """Step every lane; the `terminal_observation` of an ended episode includes its last unmeasured quantities."""
        observation, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if len(ended):
            last = self._plant(ended, self.venv.vector_info["final_info"])
            for row, lane in enumerate(ended):
                infos[lane]["terminal_observation"] = np.hstack([infos[lane]["terminal_observation"], last[row]])
        return self._seen(observation), rewards, dones, infos

    def _seen(self, observation: np.ndarray) -> np.ndarray:
        return np.hstack([observation, self._plant(slice(None))])

    def _plant(self, which: Any, info: Mapping[str, Any] | None = None) -> np.ndarray:
        """Return the unmeasured quantities (rows, size) of the lanes `which` from `info`, by default the last info."""
        info = self.venv.vector_info if info is None else info
        parts = [
            np.arcsinh((info["tip"] - info["tip_reference"])[which] / _TIP),
            np.arcsinh((info["q_link"] - info["q_motor"])[which] / 1e-4),
            np.arcsinh(info["dq_link"][which] / 1e-2),
            info["external_force"][which] / _FORCE,
        ]
        drawn = sorted(name for name in info if name.startswith("drawn_"))
        rows = [np.asarray(info[name], dtype=np.float64)[which] for name in drawn]
        return np.hstack([*parts, *(row.reshape(len(parts[0]), -1) for row in rows)]).astype(np.float32)


NOISE = 0.05
"""Standard deviation of the noise that the smoothness term adds to features."""


class GuidedPolicy(ActorCriticPolicy):
    """The networks of `stable_baselines3.PPO`, with two changes.

    The policy observes all features except the last `unseen`; the value function observes all of them. With a
    `smoothness` λ > 0, PPO's entropy term is replaced by -λ |μ(f) - μ(f + NOISE n)|² with the mean action μ and
    standard normal n (CAPS: Conditioning for Action Policy Smoothness, Mysore et al., 2021). With `ent_coef` = 1, the
    negative mean of this term is added to the loss.
    """

    def __init__(self, *arguments: Any, unseen: int = 0, smoothness: float = 0.0, **others: Any) -> None:
        self._unseen, self._smoothness = unseen, smoothness
        super().__init__(*arguments, **others)

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return values (batch, 1), log-probabilities (batch,) and the entropy term (batch,)."""
        values, log_prob, entropy = super().evaluate_actions(obs, actions)
        if self._smoothness > 0.0:
            apart = self._mean(obs + NOISE * torch.randn_like(obs)) - self._mean(obs)
            entropy = -self._smoothness * (apart * apart).sum(dim=1)
        return values, log_prob, entropy

    def _mean(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the mean actions (batch, n) for features (batch, size)."""
        mean: torch.Tensor = self.action_net(self.mlp_extractor.forward_actor(obs))
        return mean

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = _TwoSights(self.features_dim, self._unseen, self.net_arch, self.activation_fn)


class _TwoSights(MlpExtractor):
    """The hidden layers of policy and value function; the policy does not receive the last `unseen` features."""

    def __init__(self, size: int, unseen: int, widths: Any, activation: Any) -> None:
        super().__init__(size, widths, activation, "cpu")
        self._seen = size - unseen
        if unseen:
            self.policy_net = MlpExtractor(self._seen, widths, activation, "cpu").policy_net

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        latent: torch.Tensor = super().forward_actor(features[:, : self._seen])
        return latent
