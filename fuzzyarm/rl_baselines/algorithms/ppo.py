"""PPO of stable-baselines3: its settings, its presets and its part of a training."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from fuzzyarm.common.checks import real, truth
from fuzzyarm.rl_baselines.algorithm import COLUMNS, AlgorithmSpec, OnPolicyAlgorithm, OnPolicyConfig

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.learned.network import Network
    from fuzzyarm.rl_baselines.learning_env import LearningEnvs

__all__ = ["PRESETS", "SPEC", "PPOAlgorithm", "PPOConfig"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PPOConfig(OnPolicyConfig):
    """The settings of a training with PPO: see `OnPolicyConfig`, and two of its own."""

    asymmetric_critic: bool = False
    """Show the value function what no sensor measures: errors of tip and links, force, plant and payload."""
    smoothness: float = 0.0
    """Coefficient of the smoothness of actions in the loss (CAPS): mean square of the difference of the policy's means
    at normalised features and at these plus noise of 0.05."""

    def __post_init__(self) -> None:
        super().__post_init__()
        truth("asymmetric_critic", self.asymmetric_critic)
        if real("smoothness", self.smoothness, low=0.0) > 0.0 and self.ent_coef > 0.0:
            raise ValueError(f"smoothness = {self.smoothness} and ent_coef = {self.ent_coef}: one of them must be 0")


_RANDOM = PPOConfig(
    distribution="robust",
    hidden=(128, 128),
    total_timesteps=6_000_000,
    lanes=256,
    n_steps=32,
    batch_size=2048,
    n_epochs=5,
    evaluation_interval=500_000,
)

PRESETS: dict[str, PPOConfig] = {
    "nominal": PPOConfig(),
    "robust": dataclasses.replace(_RANDOM, action_period=0.001, gamma=0.99, asymmetric_critic=True, smoothness=100.0),
    "residual": dataclasses.replace(
        _RANDOM,
        base="fuzzy-4-tip",
        scale=(0.01, 0.02),
        smoothing_time=0.06,
        elastic_target=True,
        hidden=(64, 64),
        batch_size=1024,
        n_epochs=10,
    ),
    "observer": dataclasses.replace(
        _RANDOM, base="elastic-observer", scale=(300.0, 150.0), gate=1.0, action_period=0.001, past_errors=0,
        past_actions=1, integral_time=0.0, tip_error_scale=0.02, hidden=(64, 64), total_timesteps=4_000_000, n_epochs=6,
        gamma=0.99, log_std_init=-2.0, asymmetric_critic=True,
    ),
}  # fmt: skip
"""The settings of the shipped policies, by what follows ``ppo-`` in their names."""


class PPOAlgorithm(OnPolicyAlgorithm):
    """PPO in the middle of a training, see `Algorithm`."""

    def __init__(self, config: PPOConfig, envs: LearningEnvs) -> None:
        import stable_baselines3

        if config.asymmetric_critic:
            envs.show_plant()
            self._policy_sees = config.features.size
        if not (config.asymmetric_critic or config.smoothness or config.gate):
            super().__init__(config, envs, stable_baselines3.PPO, "MlpPolicy")
            return
        from fuzzyarm.rl_baselines.ppo_policy import GuidedPolicy

        own = {"unseen": envs.plant_size, "smoothness": config.smoothness, "silent": config.gate > 0.0}
        # The smoothness stands where PPO has the entropy, see `GuidedPolicy`.
        ent_coef = 1.0 if config.smoothness else None
        super().__init__(config, envs, stable_baselines3.PPO, GuidedPolicy, ent_coef=ent_coef, **own)

    def network(self) -> Network:
        """Return the mean of the Gaussian policy with the normaliser of its features."""
        policy = self.model.policy
        return self._network_of(policy.mlp_extractor.policy_net, policy.action_net)


SPEC = AlgorithmSpec(
    name="ppo",
    title="PPO of stable-baselines3",
    config=PPOConfig,
    presets=PRESETS,
    create=PPOAlgorithm,
    columns=COLUMNS,
    libraries=("torch", "stable-baselines3"),
)
"""PPO as it is registered."""
