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


def remembered(memory: np.ndarray, physics: Physics) -> Memory:
    """Return the parts of the adaptive observer's memory of one lane as views of it, each in its shape."""
    parts = zip(layout(physics), places(physics), strict=True)
    return Memory(*(memory[at].reshape(part.shape) for at, part in parts))
