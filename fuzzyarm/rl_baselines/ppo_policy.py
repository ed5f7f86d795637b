"""The networks of PPO with a value function that sees what no sensor measures, and smooth actions in the loss.

It sees the tip error, the links' errors from the reference, the tip force and what the episode drew: plant, load and
start. Errors go through asinh, in units that resolve a tenth of a millimetre.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor

from fuzzyarm.envs.observation import observed

__all__ = ["NOISE", "GuidedPolicy", "plant_view"]


_TIP, _ANGLE, _VELOCITY, _FORCE = 1e-4, 1e-4, 1e-2, 200.0  # m, rad, rad/s, N


def plant_view(info: Mapping[str, Any], observation: np.ndarray, which: Any = slice(None)) -> np.ndarray:
    """Return what the plants of some lanes do (rows, numbers), each of order 1 but for what was drawn.

    `info` is that of the whole batch, `observation` (rows, 5 n) that of the lanes `which`.
    """
    o = observed(observation)
    parts = [
        np.arcsinh((info["tip"] - info["tip_reference"])[which] / _TIP),
        np.arcsinh((info["q_link"][which] - o.q_reference) / _ANGLE),
        np.arcsinh((info["dq_link"][which] - o.dq_reference) / _VELOCITY),
        info["external_force"][which] / _FORCE,
    ]
    drawn = info.get("randomisation", {})
    names = [name for name in sorted(drawn) if not name.startswith("_")]
    rows = (np.asarray(drawn[name], dtype=np.float64)[which] for name in names)
    return np.hstack([*parts, *(row.reshape(len(observation), -1) for row in rows)])


NOISE = 0.05
"""Standard deviation of the noise on normalised features that actions should hardly depend on."""


class GuidedPolicy(ActorCriticPolicy):
    """The networks of `stable_baselines3.PPO`, with three changes.

    The policy sees all features but the last `unseen`, the value function all. With `silent` the last layer of the
    policy begins with zeros: the mean action is 0 at first. With a `smoothness` λ, what PPO takes for the entropy is
    -λ |μ(f) - μ(f + NOISE n)|² with the mean action μ and standard normal n (conditioning for action policy
    smoothness, Mysore et al., 2021); with a coefficient of the entropy of 1 the loss gains its negative mean.
    """

    def __init__(
        self, *arguments: Any, unseen: int = 0, silent: bool = False, smoothness: float = 0.0, **others: Any
    ) -> None:
        self._unseen, self._smoothness = unseen, smoothness
        super().__init__(*arguments, **others)
        if silent:
            with torch.no_grad():
                self.action_net.weight.zero_()
                self.action_net.bias.zero_()

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return values (batch, 1), log-probabilities (batch,) and what PPO takes for the entropy (batch,)."""
        values, log_prob, entropy = super().evaluate_actions(obs, actions)
        if self._smoothness > 0.0:
            apart = self._mean(obs + NOISE * torch.randn_like(obs)) - self._mean(obs)
            entropy = -self._smoothness * (apart * apart).sum(dim=1)
        return values, log_prob, entropy

    def _mean(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the mean actions (batch, n) for normalised features (batch, size)."""
        mean: torch.Tensor = self.action_net(self.mlp_extractor.forward_actor(obs))
        return mean

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = _TwoSights(self.features_dim, self._unseen, self.net_arch, self.activation_fn)


class _TwoSights(MlpExtractor):
    """The hidden layers, those of the policy without the last features."""

    def __init__(self, size: int, unseen: int, widths: Any, activation: Any) -> None:
        super().__init__(size, widths, activation, "cpu")
        self._seen = size - unseen
        if unseen:
            self.policy_net = MlpExtractor(self._seen, widths, activation, "cpu").policy_net

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        latent: torch.Tensor = super().forward_actor(features[:, : self._seen])
        return latent
