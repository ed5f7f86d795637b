"""Learning from a replay buffer with stable-baselines3: what SAC and TQC have in common.

An update is `train_freq` steps of every lane and then `gradient_steps` gradient steps. The replay buffer is part of the
checkpoint, so that a resumed training gives the same bits as one that never stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzyarm.rl_baselines.off_policy_config import OffPolicyConfig
from fuzzyarm.rl_baselines.sb3_algorithm import Sb3Algorithm

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


class OffPolicyAlgorithm(Sb3Algorithm):
    """SAC or TQC in the middle of a training, see `fuzzyarm.rl_baselines.algorithm.Algorithm`."""

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
        from stable_baselines3.common.vec_env import VecNormalize

        torch.set_num_threads(config.threads)
        self._config = config
        normaliser = VecNormalize(envs, gamma=config.gamma, norm_reward=False)
        arguments = _arguments(config)
        arguments["policy_kwargs"] |= policy_more
        super().__init__(config, normaliser, kind("MlpPolicy", normaliser, **arguments, **more))

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
        row = self._episode_row()
        if model.num_timesteps <= config.learning_starts:
            return row
        model.train(batch_size=config.batch_size, gradient_steps=config.gradient_steps)
        return row | self._logged(_LOGGED)

    def network(self) -> Network:
        """Return tanh of the mean of the squashed Gaussian policy, with the normaliser of its features."""
        actor = self.model.actor
        return self._network_of(actor.latent_pi, actor.mu, activation=self._config.activation, output="tanh")

    def state(self) -> dict[str, Any]:
        """Return networks, optimisers, replay buffer, normaliser, last features, counters and the latest episodes."""
        model, buffer = self.model, self.model.replay_buffer
        learned = {} if model.log_ent_coef is None else {"log_ent_coef": model.log_ent_coef.detach()}
        state = self._shared_state()
        state["counters"] |= {"position": buffer.pos, "full": bool(buffer.full)}
        return state | {
            "optimizers": {name: one.state_dict() for name, (one, _) in self._optimizers().items()},
            "entropy": learned,
            "buffer": {name: getattr(buffer, name) for name in _STORED},
            "last_original_features": np.asarray(model._last_original_obs),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned, see `Algorithm.set_state`."""
        import torch

        from fuzzyarm.rl_baselines.learner_state import check_off_policy_state

        parameters = {name: chosen for name, (_, chosen) in self._optimizers().items()}
        check_off_policy_state(state, self.state(), parameters)
        model, buffer, counters = self.model, self.model.replay_buffer, state["counters"]
        self._set_shared_state(state)
        for name, (optimizer, _) in self._optimizers().items():
            optimizer.load_state_dict(state["optimizers"][name])
        if model.log_ent_coef is not None:
            with torch.no_grad():
                model.log_ent_coef.copy_(state["entropy"]["log_ent_coef"])
        for name in _STORED:
            getattr(buffer, name)[:] = state["buffer"][name].numpy()
        buffer.pos, buffer.full = counters["position"], counters["full"]
        model._last_original_obs = state["last_original_features"].numpy().copy()

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
