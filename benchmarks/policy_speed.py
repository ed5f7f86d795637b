"""Processor time of one `predict` call of each policy, alone and in a batch of 1024.

python benchmarks/policy_speed.py
"""

from __future__ import annotations

import statistics
import time

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.envs.observation import SIZE
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.policies import NAMES

LANES, CALLS, REPEATS = 1024, 300, 7


def seconds_per_call(name: str, observation: np.ndarray) -> float:
    """Return the median over the repeats of the mean processor time of a call [s]."""
    policy, state, times = load_policy(name), None, []
    _, state = policy.predict(observation)
    for _ in range(REPEATS):
        begin = time.process_time()
        for _ in range(CALLS):
            _, state = policy.predict(observation, state)
        times.append((time.process_time() - begin) / CALLS)
    return statistics.median(times)


def main() -> None:
    """Measure and print."""
    observations = np.random.default_rng(0).normal(size=(LANES, SIZE))
    for name in NAMES:
        single, batch = seconds_per_call(name, observations[0]), seconds_per_call(name, observations)
        print(f"{name:16} one: {1e6 * single:5.1f} µs   batch of {LANES}: {1e6 * batch / LANES:6.3f} µs per lane")
    print(current_provenance()["machine"])


if __name__ == "__main__":
    main()
