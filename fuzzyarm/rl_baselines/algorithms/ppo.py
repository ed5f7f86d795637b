"""PPO from stable-baselines3: its settings, its presets and its part in a training run.

The settings have the names used by `stable_baselines3.PPO`. torch and stable-baselines3 are imported only when a
training run begins, so that settings and presets can be read without them.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzyarm.common.checks import real, truth, whole
from fuzzyarm.rl_baselines.algorithm import AlgorithmSpec
from fuzzyarm.rl_baselines.config import TrainingConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    from fuzzyarm.fuzzy_policy.laws.learned.network import Network
    from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

__all__ = ["PRESETS", "SPEC", "PPOConfig"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PPOConfig(TrainingConfig):
    """The settings of a training run with PPO, named as in `stable_baselines3.PPO`."""

    n_steps: int = 32
    """Steps of each lane between two updates, at least 2."""
    batch_size: int = 64
    """Samples in a gradient step, at least 2; must divide lanes times n_steps."""
    n_epochs: int = 10
    """Passes over the samples of an update."""
    learning_rate: float = 3e-4
    """Learning rate of Adam at the beginning."""
    final_learning_rate: float = 1e-5
    """Learning rate of Adam at the end; in between, the rate falls linearly."""
    gamma: float = 0.99
    """Discount factor per step (0 to 1)."""
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
    log_std_init: float = 0.0
    """Logarithm of the action's standard deviation at the beginning (-20 to 2)."""
    asymmetric_critic: bool = False
    """Let the value function also observe unmeasured quantities: errors of tip and links, force, plant and payload."""
    smoothness: float = 0.0
    """Coefficient of the smoothness term in the loss (CAPS): the mean square difference between the policy's mean
    actions at the features and at the features plus noise of 0.05."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("n_steps", self.n_steps, low=2)
        whole("batch_size", self.batch_size, low=2)
        whole("n_epochs", self.n_epochs, low=1)
        for name in ("learning_rate", "clip_range", "max_grad_norm"):
            real(name, getattr(self, name), above=0.0)
        for name in ("ent_coef", "vf_coef", "target_kl"):
            real(name, getattr(self, name), low=0.0)
        for name in ("gamma", "gae_lambda"):
            real(name, getattr(self, name), low=0.0, high=1.0)
        real("final_learning_rate", self.final_learning_rate, low=0.0, high=self.learning_rate)
        real("log_std_init", self.log_std_init, low=-20.0, high=2.0)
        samples = self.lanes * self.n_steps
        if samples % self.batch_size:
            raise ValueError(f"batch_size = {self.batch_size} must divide lanes times n_steps = {samples}")
        truth("asymmetric_critic", self.asymmetric_critic)
        if real("smoothness", self.smoothness, low=0.0) > 0.0 and self.ent_coef > 0.0:
            raise ValueError(f"smoothness = {self.smoothness} and ent_coef = {self.ent_coef}: at least one must be 0")


PRESETS: dict[str, PPOConfig] = {
    "robust": PPOConfig(),
    "nominal": PPOConfig(distribution="nominal"),
    "residual": PPOConfig(
        base="fuzzy-4-tip", scale=(0.01, 0.02), smoothing_time=0.06, elastic_target=True, past_errors=2,
        past_actions=2, integral_time=0.1, log_std_init=-1.5,
    ),
}  # fmt: skip
"""Presets by name: for two distributions of episodes, and for a policy with a base."""

_SAME = (
    "n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "vf_coef", "max_grad_norm", "seed",
)  # fmt: skip
_LOGGED = {
    "learning_rate": "learning_rate", "approx_kl": "approx_kl", "clip_fraction": "clip_fraction",
    "value_loss": "value_loss", "explained_variance": "explained_variance", "action_std": "std",
}  # fmt: skip
"""Columns of the curve, and the keys under ``train/`` at which stable-baselines3 logs them."""


class _PPOAlgorithm:
    """The algorithm PPO during a training run; for its methods see `fuzzyarm.rl_baselines.algorithm`."""

    def __init__(self, config: PPOConfig, envs: StableBaselinesVecEnv) -> None:
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.logger import Logger

        torch.set_num_threads(config.threads)
        self._config = config
        networks: dict[str, Any] = {
            "net_arch": {"pi": list(config.hidden), "vf": list(config.hidden)},
            "activation_fn": torch.nn.Tanh,
            "log_std_init": config.log_std_init,
        }
        policy: Any = "MlpPolicy"
        shown: Any = envs
        if config.asymmetric_critic or config.smoothness:
            from fuzzyarm.rl_baselines._ppo_policy import GuidedPolicy, PlantView

            shown = PlantView(envs) if config.asymmetric_critic else envs
            policy, unseen = GuidedPolicy, shown.observation_space.shape[0] - config.features.size
            networks |= {"unseen": unseen, "smoothness": config.smoothness}
        first, last = config.learning_rate, config.final_learning_rate
        self.model = PPO(
            policy,
            shown,
            # `remaining` falls from 1 to 0 over the run, and below 0 in a last update that goes past the end.
            learning_rate=lambda remaining: max(last + (first - last) * remaining, 0.0),
            policy_kwargs=networks,
            device="cpu",
            # The smoothness term replaces the entropy term, see `GuidedPolicy`.
            ent_coef=1.0 if config.smoothness else config.ent_coef,
            target_kl=config.target_kl or None,
            **{name: getattr(config, name) for name in _SAME},
        )
        self.model.set_logger(Logger(None, []))
        self.model.learn(0)  # begins the first episodes

    @property
    def steps(self) -> int:
        """Environment steps done so far, of all lanes together."""
        return int(self.model.num_timesteps)

    def learn(self, after_update: Callable[[dict[str, float]], None]) -> None:
        """Train until the run has done `total_timesteps` environment steps; see `_Algorithm.learn`."""
        from stable_baselines3.common.callbacks import BaseCallback

        algorithm, begun = self, self.steps

        class AfterUpdate(BaseCallback):
            """A callback after each update: at the beginning of the next rollout, and at the end of the run."""

            def _on_step(self) -> bool:
                return True

            def _on_rollout_start(self) -> None:
                if algorithm.steps > begun:
                    after_update(algorithm._row())

            def _on_training_end(self) -> None:
                after_update(algorithm._row())

        left = self._config.total_timesteps - begun
        self.model.learn(left, AfterUpdate(), log_interval=None, reset_num_timesteps=False)

    def _row(self) -> dict[str, float]:
        episodes = list(self.model.ep_info_buffer or ())
        ended = {"episode_reward": ("r", 1.0), "episode_length": ("l", 1.0), "tip_error_mm": ("tip_error", 1e3)}
        row = {
            name: unit * float(np.mean([one[key] for one in episodes]))
            for name, (key, unit) in ended.items()
            if episodes
        }
        logged = self.model.logger.name_to_value
        if self._config.smoothness:
            row["smoothness_loss"] = float(logged["train/entropy_loss"])  # see `GuidedPolicy`
        return row | {name: float(logged[f"train/{key}"]) for name, key in _LOGGED.items()}

    def network(self) -> Network:
        """Return the network that computes the mean action of the Gaussian policy."""
        import torch

        from fuzzyarm.fuzzy_policy.laws.learned.network import Network
        from fuzzyarm.rl_baselines.learning_task import BOUND

        policy, size = self.model.policy, self._config.features.size
        layers = [
            *(part for part in policy.mlp_extractor.policy_net if isinstance(part, torch.nn.Linear)),
            policy.action_net,
        ]
        return Network(
            mean=np.zeros(size),
            std=np.ones(size),
            clip=BOUND,
            weights=tuple(layer.weight.detach().numpy().copy() for layer in layers),
            biases=tuple(layer.bias.detach().numpy().copy() for layer in layers),
        )

    def state(self) -> dict[str, Any]:
        """Return networks, optimiser, counters, latest episodes, last features and episode starts, by name."""
        model = self.model
        return {
            "policy": model.policy.state_dict(),
            "optimizer": model.policy.optimizer.state_dict(),
            "counters": {"steps": model.num_timesteps, "updates": model._n_updates},
            "episodes": [{name: one[name] for name in ("r", "l", "tip_error")} for one in model.ep_info_buffer or ()],
            "last_features": np.asarray(model._last_obs),
            "last_starts": np.asarray(model._last_episode_starts),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state that the method `state` returned; see `_Algorithm.set_state`."""
        from fuzzyarm.rl_baselines._checkpoint import check_learner

        model, policy = self.model, self.model.policy
        check_learner(state, policy.optimizer, list(policy.parameters()))
        policy.load_state_dict(state["policy"])
        policy.optimizer.load_state_dict(state["optimizer"])
        model.num_timesteps, model._n_updates = state["counters"]["steps"], state["counters"]["updates"]
        model.ep_info_buffer = deque(state["episodes"], maxlen=model._stats_window_size)
        model._last_obs = state["last_features"].numpy().copy()
        model._last_episode_starts = state["last_starts"].numpy().copy()


SPEC = AlgorithmSpec(
    name="ppo",
    title="PPO of stable-baselines3",
    config=PPOConfig,
    presets=PRESETS,
    create=_PPOAlgorithm,
    columns=(*_LOGGED, "smoothness_loss"),
    libraries=("torch", "stable-baselines3"),
)
"""PPO's entry in `ALGORITHMS`."""
