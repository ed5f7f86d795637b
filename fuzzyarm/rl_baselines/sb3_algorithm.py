"""What the algorithms of stable-baselines3 and its contrib have in common in the middle of a training."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from fuzzyarm.learned_policy.network import Network
    from fuzzyarm.rl_baselines.config import TrainingConfig

__all__ = ["Sb3Algorithm", "moments_of", "set_moments"]


class Sb3Algorithm:
    """The part of `fuzzyarm.rl_baselines.algorithm.Algorithm` that does not depend on how is learned.

    Attributes:
        model: of stable-baselines3 or its contrib.
        normaliser: `VecNormalize` around the arms; its moments of the features go into the network that is shipped.
    """

    _policy_sees: int | None = None  # features that the policy sees, the first ones; None: all

    def __init__(self, config: TrainingConfig, normaliser: Any, model: Any) -> None:
        """Begin an episode in every lane.

        Args:
            config: the settings.
            normaliser: `VecNormalize` around the arms.
            model: made for it.
        """
        from stable_baselines3.common.logger import Logger

        self.normaliser, self.model = normaliser, model
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

        from fuzzyarm.learned_policy.network import Network

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

    def _shared_state(self) -> dict[str, Any]:
        """Return networks, normaliser of the features, last features, counters and the latest episodes."""
        model = self.model
        return {
            "policy": model.policy.state_dict(),
            "counters": {"steps": model.num_timesteps, "updates": model._n_updates},
            "episodes": [{"r": float(one["r"]), "l": int(one["l"])} for one in model.ep_info_buffer or ()],
            "last_features": np.asarray(model._last_obs),
            "last_starts": np.asarray(model._last_episode_starts),
            "normaliser": {"features": moments_of(self.normaliser.obs_rms), "discounted": self.normaliser.returns},
        }

    def _set_shared_state(self, state: dict[str, Any]) -> None:
        """Put back what `_shared_state` returned, whose arrays have become tensors."""
        model, counters, moments = self.model, state["counters"], state["normaliser"]
        model.policy.load_state_dict(state["policy"])
        model.num_timesteps, model._n_updates = counters["steps"], counters["updates"]
        model.ep_info_buffer = deque(state["episodes"], maxlen=model._stats_window_size)
        model._last_obs = state["last_features"].numpy().copy()
        model._last_episode_starts = state["last_starts"].numpy().copy()
        set_moments(self.normaliser.obs_rms, moments["features"])
        self.normaliser.returns = moments["discounted"].numpy().copy()


def moments_of(running: Any) -> dict[str, Any]:
    """Return the state of a `RunningMeanStd` of stable-baselines3."""
    return {"mean": np.asarray(running.mean), "var": np.asarray(running.var), "count": float(running.count)}


def set_moments(running: Any, moments: dict[str, Any]) -> None:
    """Put a `RunningMeanStd` back to a state, whose arrays have become tensors."""
    running.mean, running.var = moments["mean"].numpy().copy(), moments["var"].numpy().copy()
    running.count = moments["count"]
