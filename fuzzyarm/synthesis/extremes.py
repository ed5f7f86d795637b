"""The smallest value of a function of angles over a box, by samples and a pattern search; it proves nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["angles_in", "smallest_value"]

KEPT = 40  # samples that the search goes on from
FIRST_STEP, STEPS = 0.2, 25  # rad, halved where no step helps


def angles_in(ranges: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return angles (count, d) in `ranges` (d, 2) [rad]: half at random, half on multiples of π/4 and on the faces."""
    generator = np.random.default_rng(seed)
    low, high = ranges.T
    q = generator.uniform(low, high, (count, len(ranges)))
    snapped = np.clip(np.round(q * 4.0 / np.pi) * np.pi / 4.0, low, high)
    ends = np.where(generator.random(q.shape) < 0.5, low, high)
    snapped = np.where(generator.random(q.shape) < 0.15, ends, snapped)
    return np.where((np.arange(count) % 2 == 0)[:, np.newaxis], q, snapped)


def smallest_value(
    function: Callable[[np.ndarray], np.ndarray], ranges: np.ndarray, *, count: int = 3000, seed: int = 1
) -> float:
    """Return the smallest value found.

    Args:
        function: of angles (B, d) [rad], returns (B,).
        ranges: of the angles, (d, 2) [rad].
        count: samples.
        seed: of the samples.
    """
    q = angles_in(ranges, count, seed)
    values = function(q)
    best = np.argsort(values)[:KEPT]
    q, values = q[best], values[best]
    d = len(ranges)
    directions = np.concatenate([np.eye(d), -np.eye(d)])
    step = FIRST_STEP
    for _ in range(STEPS if d else 0):
        tried = np.clip(q[:, np.newaxis] + step * directions, ranges[:, 0], ranges[:, 1])
        found = function(tried.reshape(-1, d)).reshape(len(q), -1)
        place, every = np.argmin(found, axis=1), np.arange(len(q))
        better = found[every, place] < values
        q = np.where(better[:, np.newaxis], tried[every, place], q)
        values = np.where(better, found[every, place], values)
        if not better.any():
            step *= 0.5
    return float(values.min())
