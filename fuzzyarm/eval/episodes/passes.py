"""Passes: episodes along one path, one after the other, by a policy that may learn from each for the next."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.eval.episodes.rollout import Rollout, record_rollout
from fuzzyarm.fuzzy_policy.policy import Predictor, Repeated

__all__ = ["record_passes"]


class _Pass:
    """One pass of a repeated policy: it begins with a given state, and keeps the last one."""

    def __init__(self, policy: Repeated, begin: Any) -> None:
        """Take the policy and the state of the pass's beginning; None: the first pass."""
        self.policy, self.begin, self.last = policy, begin, begin
        self.beliefs = getattr(policy, "beliefs", None)

    def predict(
        self,
        observation: np.ndarray,
        state: Any = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, Any]:
        """Return what the policy returns."""
        torque, self.last = self.policy.predict(observation, self.begin if state is None else state)
        return torque, self.last


def record_passes(
    env: FuzzyArmEnv, policy: Predictor, passes: int, *, policy_name: str, case: str, seed: int
) -> list[Rollout]:
    """Run an episode of `env` again and again from ``reset(seed=seed)`` and record each pass.

    Encoder noise differs from pass to pass: pass j has the seed plus the number of passes before it. A policy without
    `repeated`, or whose `repeated` returns None, runs every pass alike. Arguments as for `record_rollout`.
    """
    repeated = getattr(policy, "repeated", lambda: None)()
    runs, state = [], None
    for number in range(passes):
        acting = policy if repeated is None else _Pass(repeated, state)
        runs.append(record_rollout(env, acting, policy_name=policy_name, case=case, seed=seed + number))
        if isinstance(acting, _Pass) and number + 1 < passes:
            state = acting.policy.begin_pass(acting.last)
    return runs
