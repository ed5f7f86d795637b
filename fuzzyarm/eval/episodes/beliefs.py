"""What a policy believes of the load while it acts, sample by sample: force at the tip and payload, with deviations.

A policy has beliefs if it has a method ``beliefs(state)`` that returns an object with the attributes ``force``,
``force_deviation`` (..., axes) [N], ``payload`` and ``payload_deviation`` (...) [kg]. It may also have ``diverged``,
whether the estimate is given up, and ``at_end``, by name whether an estimate stands at an end of its range.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["NO_BELIEFS", "Believing", "belief_names"]

NO_BELIEFS = np.empty((0, 0))
"""Those of a policy that says nothing."""


def belief_names(axes: int) -> tuple[str, ...]:
    """Return the names of the numbers kept of each sample, for a tip in a space of 2 or 3 axes."""
    forces = [f"force_{axis}" for axis in "xyz"[:axes]]
    return (*forces, *(f"{force}_deviation" for force in forces), "payload", "payload_deviation")


class Believing:
    """Notes what a policy believes after each of its calls of `predict`."""

    def __init__(self, policy: Predictor) -> None:
        """Look for the policy's beliefs."""
        self._beliefs = getattr(policy, "beliefs", None)
        self._rows: list[np.ndarray] = []
        self._diverged: int | None = None
        self._at_end: list[str] = []
        self._policy = policy

    def around(self, policy: Predictor) -> Predictor:
        """Return `policy`, which passes calls on to the one of this object, or this object around it."""
        self._policy = policy
        return policy if self._beliefs is None else self

    def predict(
        self,
        observation: np.ndarray,
        state: Any = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, Any]:
        """Return what the policy returns, and note what it believes."""
        action, state = self._policy.predict(observation, state, episode_start, deterministic)
        if self._beliefs is not None:
            found = self._beliefs(state)
            parts = found.force, found.force_deviation, found.payload, found.payload_deviation
            if self._diverged is None and np.any(getattr(found, "diverged", False)):
                self._diverged = len(self._rows)
            if self._diverged is None:
                self._at_end = [name for name, ended in getattr(found, "at_end", {}).items() if np.any(ended)]
            self._rows.append(np.concatenate([np.ravel(part) for part in parts]))
        return action, state

    def note(self, control_period: float) -> str:
        """Return in words that the policy's filter diverged, or what it believes at an end of its range; else nothing.

        `control_period` [s] gives the time.
        """
        said = []
        if self._diverged is not None:
            said.append(f"its filter diverged at {self._diverged * control_period:.3f} s, and its fallback acted since")
        if self._at_end:
            names = ", ".join(name.replace("_", " ") for name in self._at_end)
            said.append(f"its estimate of {names} stood at the end of its range at last")
        return "; ".join(said)

    def rows(self) -> np.ndarray:
        """Return what was noted, (samples, names of `belief_names`); `NO_BELIEFS` of a policy that says nothing."""
        return np.array(self._rows) if self._rows else NO_BELIEFS
