"""Policies that many tests use: loaded, and proven, once."""

from __future__ import annotations

import functools

from fuzzyarm import load_policy
from fuzzyarm.fuzzy_policy.policy import Policy


@functools.cache
def loaded(name: str) -> Policy:
    """Return a policy by name; it remembers nothing between calls, so all tests may share it."""
    return load_policy(name)
