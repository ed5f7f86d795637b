"""Recurrent PPO of sb3-contrib: PPO whose policy and value function each remember in an LSTM of their own."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from fuzzyarm.common.checks import whole
from fuzzyarm.rl_baselines.algorithm import COLUMNS, AlgorithmSpec, OnPolicyAlgorithm, OnPolicyConfig

if TYPE_CHECKING:
    import torch

    from fuzzyarm.fuzzy_policy.laws.learned.network import Network
    from fuzzyarm.rl_baselines.learning_env import LearningEnvs

__all__ = ["PRESETS", "SPEC", "RecurrentPPOAlgorithm", "RecurrentPPOConfig"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class RecurrentPPOConfig(OnPolicyConfig):
    """The settings of a training with recurrent PPO: those of PPO, and the size of the memory."""

    lstm_hidden_size: int = 32
    """Numbers that the LSTM of the policy gives on, and that of the value function (1 to 512)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("lstm_hidden_size", self.lstm_hidden_size, low=1, high=512)


_SHARED: dict[str, Any] = {"hidden": (32,), "past_errors": 0, "past_actions": 0}  # the LSTM remembers instead

PRESETS = {
    "nominal": RecurrentPPOConfig(**_SHARED),
    "robust": RecurrentPPOConfig(
        **_SHARED,
        distribution="robust",
        total_timesteps=12_000_000,
        lanes=256,
        n_steps=32,
        batch_size=2048,
        n_epochs=5,
        evaluation_interval=500_000,
    ),
}
"""Settings by name."""


class RecurrentPPOAlgorithm(OnPolicyAlgorithm):
    """Recurrent PPO in the middle of a training, see `Algorithm`.

    The memories of all lanes are part of the state, so that a resumed training gives the same bits.
    """

    def __init__(self, config: RecurrentPPOConfig, envs: LearningEnvs) -> None:
        import sb3_contrib

        size = config.lstm_hidden_size
        super().__init__(config, envs, sb3_contrib.RecurrentPPO, "MlpLstmPolicy", lstm_hidden_size=size)

    def network(self) -> Network:
        """Return the LSTM and the layers that give the mean of the Gaussian policy, with the normaliser."""
        from fuzzyarm.fuzzy_policy.laws.learned.network import Cell

        lstm = self.model.policy.lstm_actor
        bias = lstm.bias_ih_l0 + lstm.bias_hh_l0
        arrays = (part.detach().numpy().copy() for part in (lstm.weight_ih_l0, lstm.weight_hh_l0, bias))
        policy = self.model.policy
        return self._network_of(policy.mlp_extractor.policy_net, policy.action_net, cell=Cell(*arrays))

    def state(self) -> dict[str, Any]:
        """Return the state of PPO, and the memories."""
        return super().state() | {"memories": {name: one.detach() for name, one in self._memories().items()}}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned, see `Algorithm.set_state`."""
        super().set_state(state)
        for name, own in self._memories().items():
            own.copy_(state["memories"][name])

    def _memories(self) -> dict[str, torch.Tensor]:
        """Return output and content of the LSTM of the policy and of that of the value function, (1, lanes, hidden)."""
        policy, value = self.model._last_lstm_states
        return {"policy_h": policy[0], "policy_c": policy[1], "value_h": value[0], "value_c": value[1]}


SPEC = AlgorithmSpec(
    name="recurrent-ppo",
    title="recurrent PPO of sb3-contrib",
    config=RecurrentPPOConfig,
    presets=PRESETS,
    create=RecurrentPPOAlgorithm,
    columns=COLUMNS,
    libraries=("torch", "stable-baselines3", "sb3-contrib"),
)
"""Recurrent PPO as it is registered."""
