"""TQC of sb3-contrib: its settings, its presets and its part of a training."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from fuzzyarm.common.checks import whole
from fuzzyarm.rl_baselines.algorithm import AlgorithmSpec
from fuzzyarm.rl_baselines.algorithms.sac import COLUMNS, RESIDUAL, OffPolicyAlgorithm, SACConfig

if TYPE_CHECKING:
    from fuzzyarm.rl_baselines.learning_env import LearningEnvs

__all__ = ["PRESETS", "SPEC", "TQCConfig"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class TQCConfig(SACConfig):
    """The settings of a training with TQC: see `SACConfig`, and how many quantiles of the return are cut off."""

    n_critics: int = 2
    """Number of critics (1 to 100)."""
    n_quantiles: int = 25
    """Quantiles of the return that each critic estimates (1 to 1000)."""
    top_quantiles_to_drop_per_net: int = 2
    """How many of the largest quantiles of each critic are left out of the target; fewer than it has."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("n_critics", self.n_critics, low=1, high=100)
        whole("n_quantiles", self.n_quantiles, low=1, high=1000)
        whole("top_quantiles_to_drop_per_net", self.top_quantiles_to_drop_per_net, high=self.n_quantiles - 1)


PRESETS = {"nominal": TQCConfig(), "residual": TQCConfig(**RESIDUAL)}
"""Settings by name."""


def _create(config: TQCConfig, envs: LearningEnvs) -> OffPolicyAlgorithm:
    import sb3_contrib

    quantiles = {"n_critics": config.n_critics, "n_quantiles": config.n_quantiles}
    return OffPolicyAlgorithm(config, envs, sb3_contrib.TQC, ("top_quantiles_to_drop_per_net",), **quantiles)


SPEC = AlgorithmSpec(
    name="tqc",
    title="TQC of sb3-contrib",
    config=TQCConfig,
    presets=PRESETS,
    create=_create,
    columns=COLUMNS,
    libraries=("torch", "stable-baselines3", "sb3-contrib"),
)
"""TQC as it is registered."""
