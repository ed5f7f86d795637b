"""Observations at which an exported law is compared with its policy."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.observation import PARTS, starts
from fuzzyarm.envs.physics.equations import bounds_of
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["CALLS", "random_observations"]

CALLS = 200
"""Consecutive calls in a file of test vectors."""

SHARE = 0.2  # of the calls, the last ones, that see any state
FREQUENCIES = (2.0, 10.0)  # rad/s
SMALLEST, LARGEST = -8.0, -0.5  # errors, powers of ten of the limits


def random_observations(policy: Policy, calls: int, seed: int) -> np.ndarray:
    """Return observations (calls, 5 n) [rad, rad/s, rad/s²] of consecutive calls.

    First a sine in every joint, measured with errors of sizes from 1e-8 to 0.3 of the limits; then states, and wanted
    ones, anywhere within the limits.
    """
    rng, joints, bounds = np.random.default_rng(seed), policy.joints, bounds_of(policy.parameters)
    at, seen = starts(joints), np.empty((calls, PARTS * joints))
    middle, half = 0.5 * (bounds.low + bounds.high), 0.5 * (bounds.high - bounds.low)
    frequency, begin = rng.uniform(*FREQUENCIES, joints), rng.uniform(0.0, 2.0 * np.pi, joints)
    phase = begin + frequency * policy.control_period * np.arange(calls)[:, np.newaxis]
    radius = 0.3 * half
    motion = [
        middle + radius * np.sin(phase),
        radius * frequency * np.cos(phase),
        -radius * frequency**2 * np.sin(phase),
    ]
    size = 10.0 ** rng.uniform(SMALLEST, LARGEST, (calls, 1))
    error = size * rng.uniform(-1.0, 1.0, (calls, 2 * joints)) * np.concatenate([half, bounds.velocity])
    seen[:, at.q_reference :] = np.concatenate(motion, axis=1)
    seen[:, : at.q_reference] = seen[:, at.q_reference : at.ddq_reference] + error
    last = slice(round((1.0 - SHARE) * calls), calls)
    scales = (half, bounds.velocity, half, bounds.velocity, np.full(joints, 50.0))
    for part, scale in zip(at, scales, strict=True):
        seen[last, part : part + joints] = scale * rng.uniform(-1.0, 1.0, (len(seen[last]), joints))
    return seen
