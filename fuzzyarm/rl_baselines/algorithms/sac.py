"""SAC of stable-baselines3: its settings, its presets and its part of a training."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from fuzzyarm.rl_baselines.algorithm import AlgorithmSpec
from fuzzyarm.rl_baselines.off_policy import COLUMNS, RESIDUAL, OffPolicyAlgorithm, OffPolicyConfig

if TYPE_CHECKING:
    from fuzzyarm.rl_baselines.learning_env import LearningEnvs

__all__ = ["PRESETS", "SPEC", "SACConfig", "create"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SACConfig(OffPolicyConfig):
    """The settings of a training with SAC: see `OffPolicyConfig`."""


PRESETS = {"nominal": SACConfig(), "residual": SACConfig(**RESIDUAL)}
"""Settings by name."""


def create(config: SACConfig, envs: LearningEnvs) -> OffPolicyAlgorithm:
    """Return SAC at the beginning of a training."""
    import stable_baselines3

    return OffPolicyAlgorithm(config, envs, stable_baselines3.SAC)


SPEC = AlgorithmSpec(
    name="sac",
    title="SAC of stable-baselines3",
    config=SACConfig,
    presets=PRESETS,
    create=create,
    columns=COLUMNS,
    libraries=("torch", "stable-baselines3"),
)
"""SAC as it is registered."""
