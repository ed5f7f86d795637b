"""Learning from the latest steps alone with stable-baselines3: what PPO and recurrent PPO have in common.

The settings have the names that `stable_baselines3.PPO` gives them. torch and stable-baselines3 are imported when a
training begins, so that settings and presets can be read without them.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from fuzzyarm.common.checks import real, whole
from fuzzyarm.rl_baselines.config import TrainingConfig
from fuzzyarm.rl_baselines.sb3_algorithm import Sb3Algorithm, moments_of, set_moments

if TYPE_CHECKING:
    from fuzzyarm.rl_baselines.learning_env import LearningEnvs

__all__ = ["COLUMNS", "OnPolicyAlgorithm", "OnPolicyConfig"]

_LOGGED = {  # columns of the curve, and the keys under which stable-baselines3 logs them
    "learning_rate": "train/learning_rate",
    "approx_kl": "train/approx_kl",
    "clip_fraction": "train/clip_fraction",
    "value_loss": "train/value_loss",
    "explained_variance": "train/explained_variance",
    "action_std": "train/std",
}

COLUMNS = tuple(_LOGGED)
"""What these algorithms add to the curve."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class OnPolicyConfig(TrainingConfig):
    """The settings of a training with PPO of any kind: those of every training, and those of `stable_baselines3.PPO`.

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is out of range, or two values do not fit together.
    """

    n_steps: int = 64
    """Steps of each lane between two updates, at least 2."""
    batch_size: int = 1024
    """Samples in a gradient step, at least 2; must divide lanes times n_steps."""
    n_epochs: int = 8
    """Passes over the samples of an update."""
    learning_rate: float = 1e-3
    """Learning rate of Adam at the beginning."""
    final_learning_rate: float = 1e-5
    """Learning rate of Adam at the end; in between it falls linearly."""
    gamma: float = 0.98
    """Discount factor of a step (0 to 1)."""
    gae_lambda: float = 0.95
    """Factor λ of generalised advantage estimation (0 to 1)."""
    clip_range: float = 0.2
    """Clipping range of the ratio of probabilities."""
    ent_coef: float = 0.0
    """Coefficient of the entropy in the loss."""
    vf_coef: float = 0.5
    """Coefficient of the value function's error in the loss."""
    max_grad_norm: float = 0.5
    """Norm to which gradients are clipped."""
    target_kl: float = 0.0
    """An update ends early once the KL divergence exceeds 1.5 times this value; 0: never."""
    log_std_init: float = -1.5
    """Logarithm of the action's standard deviation at the beginning (-20 to 2)."""

    def __post_init__(self) -> None:
        """Check types, ranges and what must fit together."""
        super().__post_init__()
        whole("n_steps", self.n_steps, low=2)
        whole("batch_size", self.batch_size, low=2)
        whole("n_epochs", self.n_epochs, low=1)
        for name in ("learning_rate", "clip_range", "max_grad_norm"):
            real(name, getattr(self, name), above=0.0)
        for name in ("final_learning_rate", "ent_coef", "vf_coef", "target_kl"):
            real(name, getattr(self, name), low=0.0)
        for name in ("gamma", "gae_lambda"):
            real(name, getattr(self, name), low=0.0, high=1.0)
        real("log_std_init", self.log_std_init, low=-20.0, high=2.0)
        samples = self.lanes * self.n_steps
        if samples % self.batch_size:
            raise ValueError(f"batch_size = {self.batch_size} must divide lanes times n_steps = {samples}")
        if self.final_learning_rate > self.learning_rate:
            raise ValueError(
                f"final_learning_rate = {self.final_learning_rate:g} is out of range; allowed: [0, learning_rate = "
                f"{self.learning_rate:g}]"
            )


class OnPolicyAlgorithm(Sb3Algorithm):
    """PPO of any kind in the middle of a training, see `fuzzyarm.rl_baselines.algorithm.Algorithm`."""

    def __init__(self, config: OnPolicyConfig, envs: LearningEnvs, kind: Any, policy: Any, **more: Any) -> None:
        """Make the networks, seed everything that is random, and begin an episode in every lane.

        Args:
            config: the settings.
            envs: the arms.
            kind: class of the model.
            policy: class of its networks, or its name.
            **more: arguments of the networks beyond those that the algorithms share.
        """
        import torch
        from stable_baselines3.common.vec_env import VecNormalize

        torch.set_num_threads(config.threads)
        self._config = config
        normaliser, arguments = VecNormalize(envs, gamma=config.gamma), self._arguments(config)
        arguments["policy_kwargs"] |= more
        super().__init__(config, normaliser, kind(policy, normaliser, **arguments))

    def update(self) -> dict[str, float]:
        """Collect `n_steps` steps in every lane and learn from them; return the numbers for the curve.

        See `Algorithm.update`.
        """
        model = self.model
        model.collect_rollouts(model.env, self._callback, model.rollout_buffer, n_rollout_steps=self._config.n_steps)
        model._update_current_progress_remaining(model.num_timesteps, self._config.total_timesteps)
        model.train()
        return self._episode_row() | self._logged(_LOGGED)

    def state(self) -> dict[str, Any]:
        """Return networks, optimiser, normaliser, last features, counters and the latest episodes."""
        state = self._shared_state()
        state["optimizer"] = self.model.policy.optimizer.state_dict()
        state["normaliser"]["returns"] = moments_of(self.normaliser.ret_rms)
        return state

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned, see `Algorithm.set_state`."""
        from fuzzyarm.rl_baselines.learner_state import check_ppo_state

        check_ppo_state(state, self.state(), list(self.model.policy.parameters()))
        self._set_shared_state(state)
        self.model.policy.optimizer.load_state_dict(state["optimizer"])
        set_moments(self.normaliser.ret_rms, state["normaliser"]["returns"])

    def _arguments(self, config: Any) -> dict[str, Any]:
        """Return the arguments of the model."""
        import torch

        first, last = config.learning_rate, config.final_learning_rate
        widths = list(config.hidden)
        same = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef", "vf_coef", "seed")
        return {
            **{name: getattr(config, name) for name in (*same, "max_grad_norm")},
            # `remaining` of the training falls from 1 to 0, and below in the last update, which may go past the end.
            "learning_rate": lambda remaining: max(last + (first - last) * remaining, 0.0),
            "target_kl": config.target_kl or None,
            "policy_kwargs": {
                "net_arch": {"pi": widths, "vf": widths},
                "activation_fn": torch.nn.Tanh,
                "log_std_init": config.log_std_init,
            },
            "device": "cpu",
        }
