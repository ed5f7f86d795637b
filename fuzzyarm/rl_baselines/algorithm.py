"""What the trainer needs from a learning algorithm, and what the algorithms of stable-baselines3 have in common.

The settings have the names that `stable_baselines3.PPO` gives them. torch and stable-baselines3 are imported when a
training begins, so that settings and presets can be read without them.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from fuzzyarm.common.checks import real, whole
from fuzzyarm.rl_baselines.config import TrainingConfig

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.learned.network import Network
    from fuzzyarm.rl_baselines.learning_env import LearningEnvs

__all__ = ["COLUMNS", "Algorithm", "AlgorithmSpec", "OnPolicyAlgorithm", "OnPolicyConfig", "Sb3Algorithm", "Sb3Config"]


class Algorithm(Protocol):
    """A learning algorithm in the middle of a training.

    Between two calls of `update` nothing is under way: that is when the trainer evaluates the policy and writes
    checkpoints. The trainer keeps the state of the environment and of the random generators of Python, NumPy and torch;
    `state` is everything else that the next update depends on.
    """

    @property
    def steps(self) -> int:
        """Environment steps done so far, of all lanes together."""

    def update(self) -> dict[str, float]:
        """Collect experience and learn from it once.

        Returns:
            Numbers for the curve, by the columns of `AlgorithmSpec.columns` and ``episode_reward``, ``episode_length``
            [steps]; a column may be missing.
        """

    def network(self) -> Network:
        """Return the policy as it would be shipped now: the normaliser of the features and the layers."""

    def state(self) -> dict[str, Any]:
        """Return the state: nested mappings and lists of tensors, NumPy arrays, numbers and text."""

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from a state, whose arrays have become tensors; the configuration must be the same.

        Raises:
            KeyError, TypeError, ValueError, RuntimeError: the state does not fit.
        """


@dataclasses.dataclass(frozen=True)
class AlgorithmSpec:
    """An algorithm as it is registered.

    Attributes:
        name: on the command line, ``fuzzyarm train NAME``.
        title: in the help and in ``policy.json``.
        config: class of its settings; no other algorithm has the same.
        presets: settings by name; the first is the default.
        create: returns the algorithm at the beginning of a training, from the settings and the arms. It also seeds the
            arms and the random generators with ``config.seed``.
        columns: that it adds to the curve.
        libraries: distributions whose versions are recorded in ``policy.json``.
    """

    name: str
    title: str
    config: type[TrainingConfig]
    presets: Mapping[str, TrainingConfig]
    create: Callable[[Any, LearningEnvs], Algorithm]
    columns: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sb3Config(TrainingConfig):
    """The settings of every training, and those that all algorithms of stable-baselines3 have."""

    batch_size: int = 1024
    """Samples in a gradient step, at least 2."""
    learning_rate: float = 1e-3
    """Learning rate of Adam at the beginning."""
    final_learning_rate: float = 1e-5
    """Learning rate of Adam at the end; in between it falls linearly."""
    gamma: float = 0.98
    """Discount factor of a step (0 to 1)."""
    ent_coef: float = 0.0
    """Coefficient of the entropy in the loss."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("batch_size", self.batch_size, low=2)
        real("learning_rate", self.learning_rate, above=0.0)
        real("final_learning_rate", self.final_learning_rate, low=0.0, high=self.learning_rate)
        real("gamma", self.gamma, low=0.0, high=1.0)
        real("ent_coef", self.ent_coef, low=0.0)


class Sb3Algorithm:
    """What all algorithms of stable-baselines3 and its contrib share: `model` learns behind a `VecNormalize`.

    Its arguments are the settings named in `same`, the `networks` of its policy, and `more`.
    """

    _policy_sees: int | None = None  # features that the policy sees, the first ones; None: all

    def __init__(
        self,
        config: Any,
        envs: LearningEnvs,
        kind: Callable[..., Any],
        policy: Any,
        *,
        same: Iterable[str],
        networks: Mapping[str, Any],
        norm_reward: bool = True,
        **more: Any,
    ) -> None:
        import torch
        from stable_baselines3.common.logger import Logger
        from stable_baselines3.common.vec_env import VecNormalize

        torch.set_num_threads(config.threads)
        self._config = config
        self.normaliser: Any = VecNormalize(envs, gamma=config.gamma, norm_reward=norm_reward)
        first, last = config.learning_rate, config.final_learning_rate
        self.model = model = kind(
            policy,
            self.normaliser,
            # `remaining` of the training falls from 1 to 0, and below in the last update, which may go past the end.
            learning_rate=lambda remaining: max(last + (first - last) * remaining, 0.0),
            policy_kwargs=dict(networks),
            device="cpu",
            **{name: getattr(config, name) for name in ("batch_size", "gamma", "seed", *same)},
            **more,
        )
        model.set_logger(Logger(None, []))
        # `learn` of stable-baselines3 cannot be left between two updates; `update` holds the body of its loop instead.
        _, self._callback = model._setup_learn(config.total_timesteps)

    @property
    def steps(self) -> int:
        """Environment steps done so far, of all lanes together."""
        return int(self.model.num_timesteps)

    def _episode_row(self) -> dict[str, float]:
        """Return the mean reward and length [steps] of the latest episodes, if there are any."""
        episodes = list(self.model.ep_info_buffer or ())
        if not episodes:
            return {}
        return {
            "episode_reward": float(np.mean([one["r"] for one in episodes])),
            "episode_length": float(np.mean([one["l"] for one in episodes])),
        }

    def _logged(self, keys: Mapping[str, str]) -> dict[str, float]:
        """Return numbers that stable-baselines3 logged, by column of the curve, from their keys."""
        return {name: float(self.model.logger.name_to_value[key]) for name, key in keys.items()}

    def _network_of(self, parts: Iterable[Any], last: Any, **kinds: Any) -> Network:
        """Return the linear layers among parts of torch and a last one, with the normaliser of the features."""
        import torch

        from fuzzyarm.fuzzy_policy.laws.learned.network import Network

        moments = self.normaliser.obs_rms
        layers = [*(part for part in parts if isinstance(part, torch.nn.Linear)), last]
        seen = slice(self._policy_sees)
        return Network(
            mean=moments.mean[seen].copy(),
            std=np.sqrt(moments.var + self.normaliser.epsilon)[seen],
            clip=self.normaliser.clip_obs,
            weights=tuple(layer.weight.detach().numpy().copy() for layer in layers),
            biases=tuple(layer.bias.detach().numpy().copy() for layer in layers),
            **kinds,
        )

    def _optimizers(self) -> dict[str, tuple[Any, list[Any]]]:
        """Return the optimisers, each with its parameters, in its order."""
        policy = self.model.policy
        return {"optimizer": (policy.optimizer, list(policy.parameters()))}

    def state(self) -> dict[str, Any]:
        """Return networks, optimisers, moments of features and returns, last features, counters, latest episodes."""
        model, normaliser = self.model, self.normaliser
        optimizers = {name: one.state_dict() for name, (one, _) in self._optimizers().items()}
        moments = {"returns": _moments(normaliser.ret_rms)} if normaliser.norm_reward else {}
        return {
            "policy": model.policy.state_dict(),
            **(optimizers if "optimizer" in optimizers else {"optimizers": optimizers}),
            "counters": {"steps": model.num_timesteps, "updates": model._n_updates},
            "episodes": [{"r": float(one["r"]), "l": int(one["l"])} for one in model.ep_info_buffer or ()],
            "last_features": np.asarray(model._last_obs),
            "last_starts": np.asarray(model._last_episode_starts),
            "normaliser": {"features": _moments(normaliser.obs_rms), "discounted": normaliser.returns, **moments},
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned, see `Algorithm.set_state`."""
        from fuzzyarm.rl_baselines.checkpoint import check_learner

        model, held, moments = self.model, state.get("optimizers", state), state["normaliser"]
        check_learner(state, [(held[name], *own) for name, own in self._optimizers().items()])
        model.policy.load_state_dict(state["policy"])
        for name, (optimizer, _) in self._optimizers().items():
            optimizer.load_state_dict(held[name])
        model.num_timesteps, model._n_updates = state["counters"]["steps"], state["counters"]["updates"]
        model.ep_info_buffer = deque(state["episodes"], maxlen=model._stats_window_size)
        model._last_obs = state["last_features"].numpy().copy()
        model._last_episode_starts = state["last_starts"].numpy().copy()
        self.normaliser.returns = moments["discounted"].numpy().copy()
        for name, running in (("features", self.normaliser.obs_rms), ("returns", self.normaliser.ret_rms)):
            if name in moments:
                running.mean, running.var = (moments[name][part].numpy().copy() for part in ("mean", "var"))
                running.count = moments[name]["count"]


def _moments(running: Any) -> dict[str, Any]:
    """Return the state of a `RunningMeanStd` of stable-baselines3."""
    return {"mean": np.asarray(running.mean), "var": np.asarray(running.var), "count": float(running.count)}


_SAME = ("learning_rate", "approx_kl", "clip_fraction", "value_loss", "explained_variance")
# Columns of the curve, and the keys under which stable-baselines3 logs them.
_LOGGED = {name: f"train/{name}" for name in _SAME} | {"action_std": "train/std"}

COLUMNS = tuple(_LOGGED)
"""What these algorithms add to the curve."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class OnPolicyConfig(Sb3Config):
    """The settings of a training with PPO of any kind, with the names of `stable_baselines3.PPO`."""

    n_steps: int = 64
    """Steps of each lane between two updates, at least 2."""
    batch_size: int = 1024
    """Samples in a gradient step, at least 2; must divide lanes times n_steps."""
    n_epochs: int = 8
    """Passes over the samples of an update."""
    gae_lambda: float = 0.95
    """Factor λ of generalised advantage estimation (0 to 1)."""
    clip_range: float = 0.2
    """Clipping range of the ratio of probabilities."""
    vf_coef: float = 0.5
    """Coefficient of the value function's error in the loss."""
    max_grad_norm: float = 0.5
    """Norm to which gradients are clipped."""
    target_kl: float = 0.0
    """An update ends early once the KL divergence exceeds 1.5 times this value; 0: never."""
    log_std_init: float = -1.5
    """Logarithm of the action's standard deviation at the beginning (-20 to 2)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("n_steps", self.n_steps, low=2)
        whole("n_epochs", self.n_epochs, low=1)
        for name in ("clip_range", "max_grad_norm"):
            real(name, getattr(self, name), above=0.0)
        for name in ("vf_coef", "target_kl"):
            real(name, getattr(self, name), low=0.0)
        real("gae_lambda", self.gae_lambda, low=0.0, high=1.0)
        real("log_std_init", self.log_std_init, low=-20.0, high=2.0)
        samples = self.lanes * self.n_steps
        if samples % self.batch_size:
            raise ValueError(f"batch_size = {self.batch_size} must divide lanes times n_steps = {samples}")


class OnPolicyAlgorithm(Sb3Algorithm):
    """PPO of any kind; `ent_coef` replaces that of the settings, `more` are arguments of the networks."""

    def __init__(
        self,
        config: OnPolicyConfig,
        envs: LearningEnvs,
        kind: Any,
        policy: Any,
        ent_coef: float | None = None,
        **more: Any,
    ) -> None:
        import torch

        nets = {"pi": list(config.hidden), "vf": list(config.hidden)}
        super().__init__(
            config,
            envs,
            kind,
            policy,
            same=("n_steps", "n_epochs", "gae_lambda", "clip_range", "vf_coef", "max_grad_norm"),
            networks={"net_arch": nets, "activation_fn": torch.nn.Tanh, "log_std_init": config.log_std_init, **more},
            ent_coef=config.ent_coef if ent_coef is None else ent_coef,
            target_kl=config.target_kl or None,
        )

    def update(self) -> dict[str, float]:
        """Collect `n_steps` steps in every lane and learn from them; return the numbers for the curve."""
        model = self.model
        model.collect_rollouts(model.env, self._callback, model.rollout_buffer, n_rollout_steps=self._config.n_steps)
        model._update_current_progress_remaining(model.num_timesteps, self._config.total_timesteps)
        model.train()
        return self._episode_row() | self._logged(_LOGGED)
