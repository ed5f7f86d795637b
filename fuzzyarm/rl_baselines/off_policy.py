"""Learning from a replay buffer with stable-baselines3: what SAC and TQC have in common.

An update is `train_freq` steps of every lane and then `gradient_steps` gradient steps. The replay buffer is part of the
checkpoint, so that a resumed training gives the same bits as one that never stopped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzyarm.rl_baselines.moments import moments_of, set_moments
from fuzzyarm.rl_baselines.off_policy_config import OffPolicyConfig

if TYPE_CHECKING:
    from fuzzyarm.learned_policy.network import Network
    from fuzzyarm.rl_baselines.learning_env import LearningEnvs

__all__ = ["COLUMNS", "OffPolicyAlgorithm"]

_LOGGED = {  # columns of the curve, and the keys under which stable-baselines3 logs them
    "learning_rate": "train/learning_rate",
    "actor_loss": "train/actor_loss",
    "critic_loss": "train/critic_loss",
    "ent_coef": "train/ent_coef",
}
_STORED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")  # of the replay buffer

COLUMNS = tuple(_LOGGED)
"""What these algorithms add to the curve."""


class OffPolicyAlgorithm:
    """SAC or TQC in the middle of a training, see `fuzzyarm.rl_baselines.algorithm.Algorithm`.

    Attributes:
        model: of stable-baselines3 or its contrib.
        normaliser: `VecNormalize` around the arms; its moments of the features go into the network that is shipped.
    """

    def __init__(
        self,
        config: OffPolicyConfig,
        envs: LearningEnvs,
        kind: Callable[..., Any],
        more: dict[str, Any],
        policy_more: dict[str, Any],
    ) -> None:
        """Make the networks, seed everything that is random, and begin an episode in every lane.

        Args:
            config: the settings.
            envs: the arms.
            kind: class of the model.
            more: arguments of it beyond those that the algorithms share.
            policy_more: arguments of its networks, likewise.
        """
        import torch
        from stable_baselines3.common.logger import Logger
        from stable_baselines3.common.vec_env import VecNormalize

        torch.set_num_threads(config.threads)
        self._config = config
        self.normaliser = VecNormalize(envs, gamma=config.gamma, norm_reward=False)
        arguments = _arguments(config)
        arguments["policy_kwargs"] |= policy_more
        self.model = kind("MlpPolicy", self.normaliser, **arguments, **more)
        self.model.set_logger(Logger(None, []))
        # `learn` of stable-baselines3 cannot be left between two updates; `update` holds the body of its loop instead.
        _, self._callback = self.model._setup_learn(config.total_timesteps)

    @property
    def steps(self) -> int:
        """Environment steps done so far, of all lanes together."""
        return int(self.model.num_timesteps)

    def update(self) -> dict[str, float]:
        """Collect `train_freq` steps in every lane, learn from the buffer, and return the numbers for the curve."""
        model, config = self.model, self._config
        model.collect_rollouts(
            model.env,
            train_freq=model.train_freq,
            callback=self._callback,
            learning_starts=config.learning_starts,
            replay_buffer=model.replay_buffer,
        )
        model._update_current_progress_remaining(model.num_timesteps, config.total_timesteps)
        row = {}
        episodes = list(model.ep_info_buffer or ())
        if episodes:
            row["episode_reward"] = float(np.mean([one["r"] for one in episodes]))
            row["episode_length"] = float(np.mean([one["l"] for one in episodes]))
        if model.num_timesteps <= config.learning_starts:
            return row
        model.train(batch_size=config.batch_size, gradient_steps=config.gradient_steps)
        return row | {name: float(model.logger.name_to_value[key]) for name, key in _LOGGED.items()}

    def network(self) -> Network:
        """Return tanh of the mean of the squashed Gaussian policy, with the normaliser of its features."""
        import torch

        from fuzzyarm.learned_policy.network import Network

        actor, moments = self.model.actor, self.normaliser.obs_rms
        layers = [*(part for part in actor.latent_pi if isinstance(part, torch.nn.Linear)), actor.mu]
        return Network(
            mean=moments.mean.copy(),
            std=np.sqrt(moments.var + self.normaliser.epsilon),
            clip=self.normaliser.clip_obs,
            weights=tuple(layer.weight.detach().numpy().copy() for layer in layers),
            biases=tuple(layer.bias.detach().numpy().copy() for layer in layers),
            activation=self._config.activation,
            output="tanh",
        )

    def state(self) -> dict[str, Any]:
        """Return networks, optimisers, replay buffer, normaliser, last features, counters and the latest episodes."""
        model, buffer = self.model, self.model.replay_buffer
        learned = {} if model.log_ent_coef is None else {"log_ent_coef": model.log_ent_coef.detach()}
        return {
            "policy": model.policy.state_dict(),
            "optimizers": {name: one.state_dict() for name, (one, _) in self._optimizers().items()},
            "entropy": learned,
            "buffer": {name: getattr(buffer, name) for name in _STORED},
            "counters": {
                "steps": model.num_timesteps,
                "updates": model._n_updates,
                "position": buffer.pos,
                "full": bool(buffer.full),
            },
            "episodes": [{"r": float(one["r"]), "l": int(one["l"])} for one in model.ep_info_buffer or ()],
            "last_features": np.asarray(model._last_obs),
            "last_original_features": np.asarray(model._last_original_obs),
            "last_starts": np.asarray(model._last_episode_starts),
            "normaliser": {"features": moments_of(self.normaliser.obs_rms), "discounted": self.normaliser.returns},
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned, see `Algorithm.set_state`."""
        import torch

        from fuzzyarm.rl_baselines.learner_state import check_off_policy_state

        parameters = {name: chosen for name, (_, chosen) in self._optimizers().items()}
        check_off_policy_state(state, self.state(), parameters)
        model, buffer, counters = self.model, self.model.replay_buffer, state["counters"]
        model.policy.load_state_dict(state["policy"])
        for name, (optimizer, _) in self._optimizers().items():
            optimizer.load_state_dict(state["optimizers"][name])
        if model.log_ent_coef is not None:
            with torch.no_grad():
                model.log_ent_coef.copy_(state["entropy"]["log_ent_coef"])
        for name in _STORED:
            getattr(buffer, name)[:] = state["buffer"][name].numpy()
        buffer.pos, buffer.full = counters["position"], counters["full"]
        model.num_timesteps, model._n_updates = counters["steps"], counters["updates"]
        model.ep_info_buffer = deque(state["episodes"], maxlen=model._stats_window_size)
        model._last_obs = state["last_features"].numpy().copy()
        model._last_original_obs = state["last_original_features"].numpy().copy()
        model._last_episode_starts = state["last_starts"].numpy().copy()
        set_moments(self.normaliser.obs_rms, state["normaliser"]["features"])
        self.normaliser.returns = state["normaliser"]["discounted"].numpy().copy()

    def _optimizers(self) -> dict[str, tuple[Any, list[Any]]]:
        """Return the optimisers, each with its parameters."""
        model = self.model
        networks = {"actor": model.actor, "critic": model.critic}
        found = {name: (part.optimizer, list(part.parameters())) for name, part in networks.items()}
        if model.ent_coef_optimizer is not None:
            found["entropy"] = (model.ent_coef_optimizer, [model.log_ent_coef])
        return found


def _arguments(config: OffPolicyConfig) -> dict[str, Any]:
    """Return the arguments that the models share."""
    import torch

    first, last = config.learning_rate, config.final_learning_rate
    same = ("buffer_size", "learning_starts", "batch_size", "tau", "gamma", "train_freq", "gradient_steps", "seed")
    return {
        **{name: getattr(config, name) for name in same},
        "learning_rate": lambda remaining: max(last + (first - last) * remaining, 0.0),
        "ent_coef": config.ent_coef or "auto_0.1",
        "target_entropy": config.target_entropy,
        "policy_kwargs": {
            "net_arch": list(config.hidden),
            "activation_fn": torch.nn.ReLU if config.activation == "relu" else torch.nn.Tanh,
        },
        "device": "cpu",
    }
