"""Episodes of a policy, recorded in a batch: what it saw, what it did, and what came of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.dataset.config import CONDITIONS, Condition
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["Episode", "RandomTorques", "mean_return", "record"]

_LANES = 64  # episodes at once


@dataclasses.dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps."""

    seed: int  # that the environment was reset with
    observations: np.ndarray  # (T + 1, 10), the last one after the last step
    actions: np.ndarray  # (T, 2) torques of the step, with noise [N m]
    intended: np.ndarray  # (T, 2) what the policy chose, without noise, within the limits [N m]
    rewards: np.ndarray  # (T,)
    tip_errors: np.ndarray  # (T,) after each step [m]
    completed: bool  # whether the reference was followed to its end


class RandomTorques:
    """A policy that draws each torque uniformly within its limits (2,) [N m]."""

    def __init__(self, limit: np.ndarray, seed: int) -> None:
        """Begin the stream of draws."""
        self._limit, self._generator = limit, np.random.default_rng(seed)

    def predict(
        self, observation: np.ndarray, state: None = None, episode_start: object = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Return torques (lanes, 2) [N m] for observations (lanes, 10)."""
        return self._generator.uniform(-self._limit, self._limit, (len(observation), len(self._limit))), None


def record(policy: Predictor, condition: Condition, count: int, seed: int, noise: float = 0.0) -> Iterator[Episode]:
    """Yield `count` episodes of a policy at 1 kHz; `seed` is that of the first, and the others follow.

    Noise on the torques is Gaussian, with this standard deviation as a share of their limits.
    """
    for first in range(0, count, _LANES):
        yield from _batch(policy, condition, min(_LANES, count - first), seed + first, noise)


def mean_return(policy: Predictor, condition: Condition, count: int, seed: int) -> float:
    """Return the mean over episodes of the sum of their rewards, a number without a unit; arguments as for `record`."""
    return float(np.mean([one.rewards.sum() for one in record(policy, condition, count, seed)]))


def _batch(policy: Predictor, condition: Condition, lanes: int, seed: int, noise: float) -> Iterator[Episode]:
    """Yield an episode of each lane of a batch."""
    envs = FuzzyArmVectorEnv(lanes, **CONDITIONS[condition], threads=1)
    limit, generator = np.array(ArmParameters().torque_limit), np.random.default_rng([seed, lanes])
    intended, actions = list[np.ndarray](), list[np.ndarray]()

    def actuate(torque: np.ndarray) -> np.ndarray:
        intended.append(np.clip(torque, -limit, limit))
        noisy = intended[-1] + noise * limit * generator.normal(size=torque.shape) if noise > 0.0 else intended[-1]
        actions.append(np.clip(noisy, -limit, limit))
        return actions[-1]

    observation, info = envs.reset(seed=seed)
    observations, rewards, errors = [observation.copy()], list[np.ndarray](), list[np.ndarray]()
    steps, completed = np.zeros(lanes, dtype=int), np.zeros(lanes, dtype=bool)
    for step in episodes(envs, policy, (observation, info), actuate=actuate):
        observations.append(step.observation.copy())
        rewards.append(step.reward.copy())
        errors.append(step.info["tip_error"].copy())
        steps += step.running
        completed |= step.completed
    envs.close()
    rows = [np.stack(part, axis=1) for part in (actions, intended, rewards, errors)]
    seen = np.stack(observations, axis=1)
    for lane, length in enumerate(steps.tolist()):
        done, wanted, earned, error = (row[lane, :length] for row in rows)
        yield Episode(seed + lane, seen[lane, : length + 1], done, wanted, earned, error, bool(completed[lane]))
