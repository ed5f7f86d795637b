"""The settings that SAC and TQC share, with the names of stable-baselines3."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, get_args

from fuzzyarm.common.checks import choice, real, whole
from fuzzyarm.rl_baselines.config import TrainingConfig

__all__ = ["RESIDUAL", "Activation", "OffPolicyConfig"]

Activation = Literal["tanh", "relu"]
"""The function of the hidden layers."""

RESIDUAL: dict[str, Any] = {
    "distribution": "robust",
    "base": "fuzzy-4-tip",
    "scale": (0.01, 0.02),
    "smoothing_time": 0.06,
    "elastic_target": True,
}
"""The settings of the preset "residual", which shifts the target of a base [rad] through a low-pass [s]."""
_LARGEST_BUFFER = 2**29  # bytes; it is part of every checkpoint


@dataclasses.dataclass(frozen=True, kw_only=True)
class OffPolicyConfig(TrainingConfig):
    """The settings of a training from a replay buffer: those of every training, and those of stable-baselines3.

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is out of range, or two values do not fit together.
    """

    total_timesteps: int = 400_000
    """Environment steps of the training, of all lanes together."""
    lanes: int = 16
    """Number of arms that are simulated at once (1 to 65536)."""
    evaluation_interval: int = 50_000
    """Environment steps between two evaluations on the paper's three cases."""
    checkpoint_interval: int = 100_000
    """Environment steps between two checkpoints, which hold the replay buffer."""
    activation: Activation = "relu"
    """Function of the hidden layers of all networks: tanh or relu."""
    buffer_size: int = 200_000
    """Transitions that the replay buffer holds; it and the features must fit into 512 MiB."""
    learning_starts: int = 5_000
    """Environment steps with random actions before the first gradient step."""
    train_freq: int = 32
    """Steps of each lane between two rounds of gradient steps."""
    gradient_steps: int = 64
    """Gradient steps of a round."""
    batch_size: int = 256
    """Samples in a gradient step, at least 2."""
    learning_rate: float = 1e-3
    """Learning rate of Adam at the beginning."""
    final_learning_rate: float = 1e-5
    """Learning rate of Adam at the end; in between it falls linearly."""
    gamma: float = 0.98
    """Discount factor of a step (0 to 1)."""
    tau: float = 0.005
    """Share of the networks that the target networks take over at each gradient step (above 0 to 1)."""
    ent_coef: float = 0.0
    """Coefficient of the entropy in the reward; 0: it is learned."""
    target_entropy: float = -4.0
    """Entropy of the action that a learned coefficient aims at; lower: less exploration."""

    def __post_init__(self) -> None:
        """Check types, ranges and what must fit together."""
        super().__post_init__()
        choice("activation", self.activation, get_args(Activation))
        for name in ("buffer_size", "train_freq", "gradient_steps"):
            whole(name, getattr(self, name), low=1)
        whole("learning_starts", self.learning_starts)
        whole("batch_size", self.batch_size, low=2)
        real("learning_rate", self.learning_rate, above=0.0)
        real("final_learning_rate", self.final_learning_rate, low=0.0, high=self.learning_rate)
        real("gamma", self.gamma, low=0.0, high=1.0)
        real("tau", self.tau, above=0.0, high=1.0)
        real("ent_coef", self.ent_coef, low=0.0)
        real("target_entropy", self.target_entropy)
        most = _LARGEST_BUFFER // (8 * (self.features.size + 4))
        if not self.lanes <= self.buffer_size <= most:
            raise ValueError(
                f"buffer_size = {self.buffer_size} is out of range; allowed: lanes = {self.lanes} to {most} with "
                f"{self.features.size} features"
            )
