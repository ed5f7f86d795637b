"""Policies that many tests use: loaded, and proven, once."""

from __future__ import annotations

import functools

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import Memory, layout, places
from fuzzyarm.fuzzy_policy.policy import Policy


@functools.cache
def loaded(name: str) -> Policy:
    """Return a policy by name; it remembers nothing between calls, so all tests may share it."""
    return load_policy(name)


def answers(policy: Policy, seen: np.ndarray, starts: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the policy's torques (calls, lanes, n) at one observation after the other, and its last memories."""
    torques, state = [], None
    for k, observation in enumerate(seen):
        torque, state = policy.predict(observation, state, None if starts is None else starts[k])
        torques.append(torque)
    return np.array(torques), state


def remembered(memory: np.ndarray, physics: Physics) -> Memory:
    """Return the parts of the adaptive observer's memory of one lane as views of it, each in its shape."""
    parts = zip(layout(physics), places(physics), strict=True)
    return Memory(*(memory[at].reshape(part.shape) for at, part in parts))
