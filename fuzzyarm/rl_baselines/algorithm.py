"""The trainer's interface to a learning algorithm."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

from fuzzyarm.rl_baselines.config import TrainingConfig

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.learned.network import Network
    from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

__all__ = ["AlgorithmSpec"]


class _Algorithm(Protocol):
    """A learning algorithm during a training run.

    After each update it calls the trainer, which evaluates the policy and writes checkpoints. The trainer saves the
    states of the environment and of the random generators of Python, NumPy and torch; `state` is everything else that
    the next update depends on.
    """

    @property
    def steps(self) -> int:
        """Environment steps done so far, of all lanes together."""

    def learn(self, after_update: Callable[[dict[str, float]], None]) -> None:
        """Continue until ``config.total_timesteps`` steps are done.

        `after_update` is called after every update with a row of the learning curve: values by the names in
        `AlgorithmSpec.columns`, and ``episode_reward``, ``episode_length`` [steps] and ``tip_error_mm`` of the episodes
        that ended last. Columns may be missing.
        """

    def network(self) -> Network:
        """Return the network of the current policy, as it would be shipped."""

    def state(self) -> dict[str, Any]:
        """Return the algorithm's state: nested mappings and lists of tensors, NumPy arrays, numbers and text."""

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore the state that `state` returned with the same configuration, its NumPy arrays given as tensors.

        Raises:
            KeyError, TypeError, ValueError, RuntimeError: the state does not fit.
        """


@dataclasses.dataclass(frozen=True)
class AlgorithmSpec:
    """A registered algorithm.

    Attributes:
        name: NAME in the command ``fuzzyarm train NAME``.
        title: text in the help and in ``policy.json``.
        config: class of its settings; must differ from that of every other algorithm.
        presets: settings by name; the first is the default.
        create: returns the algorithm at the beginning of a training run, from the settings and the arms. It must also
            seed the arms and the random generators with ``config.seed``.
        columns: the columns that the algorithm adds to the learning curve.
        libraries: distributions whose versions are recorded in ``policy.json``.
    """

    name: str
    title: str
    config: type[TrainingConfig]
    presets: Mapping[str, TrainingConfig]
    create: Callable[[Any, StableBaselinesVecEnv], _Algorithm]
    columns: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
