"""SAC of stable-baselines3, and what TQC has in common with it: learning from a replay buffer.

An update is `train_freq` steps of every lane and then `gradient_steps` gradient steps. The replay buffer is part of the
checkpoint, so that a resumed training gives the same bits as one that never stopped.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from fuzzyarm.common.checks import choice, real, whole
from fuzzyarm.rl_baselines.algorithm import AlgorithmSpec, Sb3Algorithm, Sb3Config

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.learned.network import Network
    from fuzzyarm.rl_baselines.learning_env import LearningEnvs

__all__ = ["COLUMNS", "PRESETS", "RESIDUAL", "SPEC", "OffPolicyAlgorithm", "SACConfig"]

_Activation = Literal["tanh", "relu"]

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
class SACConfig(Sb3Config):
    """The settings of a training with SAC, with the names of `stable_baselines3.SAC`."""

    total_timesteps: int = 400_000
    """Environment steps of the training, of all lanes together."""
    lanes: int = 16
    """Number of arms that are simulated at once (1 to 65536)."""
    evaluation_interval: int = 50_000
    """Environment steps between two evaluations on the paper's three cases."""
    checkpoint_interval: int = 100_000
    """Environment steps between two checkpoints, which hold the replay buffer."""
    activation: _Activation = "relu"
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
    tau: float = 0.005
    """Share of the networks that the target networks take over at each gradient step (above 0 to 1)."""
    ent_coef: float = 0.0
    """Coefficient of the entropy in the reward; 0: it is learned."""
    target_entropy: float = -4.0
    """Entropy of the action that a learned coefficient aims at; lower: less exploration."""

    def __post_init__(self) -> None:
        super().__post_init__()
        choice("activation", self.activation, get_args(_Activation))
        for name in ("buffer_size", "train_freq", "gradient_steps"):
            whole(name, getattr(self, name), low=1)
        whole("learning_starts", self.learning_starts)
        real("tau", self.tau, above=0.0, high=1.0)
        real("target_entropy", self.target_entropy)
        most = _LARGEST_BUFFER // (8 * (self.features.size + 4))
        if not self.lanes <= self.buffer_size <= most:
            raise ValueError(
                f"buffer_size = {self.buffer_size} is out of range; allowed: lanes = {self.lanes} to {most} with "
                f"{self.features.size} features"
            )


# Columns of the curve, and the keys under which stable-baselines3 logs them.
_LOGGED = {name: f"train/{name}" for name in ("learning_rate", "actor_loss", "critic_loss", "ent_coef")}
_STORED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")  # of the replay buffer

COLUMNS = tuple(_LOGGED)
"""What these algorithms add to the curve."""


class OffPolicyAlgorithm(Sb3Algorithm):
    """SAC or TQC: `own` are settings that only one model has, `more` arguments of its networks."""

    def __init__(
        self, config: SACConfig, envs: LearningEnvs, kind: Callable[..., Any], own: tuple[str, ...] = (), **more: Any
    ) -> None:
        import torch

        shared = ("buffer_size", "learning_starts", "tau", "train_freq", "gradient_steps", "target_entropy")
        activation = torch.nn.ReLU if config.activation == "relu" else torch.nn.Tanh
        super().__init__(
            config,
            envs,
            kind,
            "MlpPolicy",
            same=(*shared, *own),
            networks={"net_arch": list(config.hidden), "activation_fn": activation, **more},
            norm_reward=False,
            ent_coef=config.ent_coef or "auto_0.1",
        )

    def update(self) -> dict[str, float]:
        """Collect `train_freq` steps in every lane, learn from the buffer, and return the numbers for the curve."""
        model, config = self.model, self._config
        starts, buffer = config.learning_starts, model.replay_buffer
        model.collect_rollouts(model.env, self._callback, model.train_freq, buffer, learning_starts=starts)
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
        """Return the shared state, the replay buffer, and the coefficient of the entropy if it is learned."""
        model, buffer, state = self.model, self.model.replay_buffer, super().state()
        state["counters"] |= {"position": buffer.pos, "full": bool(buffer.full)}
        return state | {
            "entropy": {} if model.log_ent_coef is None else {"log_ent_coef": model.log_ent_coef.detach()},
            "buffer": {name: getattr(buffer, name) for name in _STORED},
            "last_original_features": np.asarray(model._last_original_obs),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned, see `Algorithm.set_state`."""
        import torch

        model, buffer, counters = self.model, self.model.replay_buffer, state["counters"]
        whole("learner.counters.position", counters["position"], high=len(buffer.rewards) - 1)
        super().set_state(state)
        if model.log_ent_coef is not None:
            with torch.no_grad():
                model.log_ent_coef.copy_(state["entropy"]["log_ent_coef"])
        for name in _STORED:
            getattr(buffer, name)[:] = state["buffer"][name].numpy()
        buffer.pos, buffer.full = counters["position"], counters["full"]
        model._last_original_obs = state["last_original_features"].numpy().copy()

    def _optimizers(self) -> dict[str, tuple[Any, list[Any]]]:
        model = self.model
        networks = {"actor": model.actor, "critic": model.critic}
        found = {name: (part.optimizer, list(part.parameters())) for name, part in networks.items()}
        if model.ent_coef_optimizer is not None:
            found["entropy"] = (model.ent_coef_optimizer, [model.log_ent_coef])
        return found


PRESETS = {"nominal": SACConfig(), "residual": SACConfig(**RESIDUAL)}
"""Settings by name."""


def _create(config: SACConfig, envs: LearningEnvs) -> OffPolicyAlgorithm:
    import stable_baselines3

    return OffPolicyAlgorithm(config, envs, stable_baselines3.SAC)


SPEC = AlgorithmSpec(
    name="sac",
    title="SAC of stable-baselines3",
    config=SACConfig,
    presets=PRESETS,
    create=_create,
    columns=COLUMNS,
    libraries=("torch", "stable-baselines3"),
)
"""SAC as it is registered."""
