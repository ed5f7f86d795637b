"""A law as a policy: one arm alone and many at once give the same bits, from any thread."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fuzzyarm import load_policy

STEPS = 200


def run(policy, rows):
    """Torques and memories of `command` along observations (steps, lanes, 10), as copies."""
    memory, found = np.zeros((rows.shape[1], policy.memory_size)), []
    for row in rows:
        torque = np.empty((len(row), 2))
        assert policy.command(row, memory, torque)
        found.append(np.concatenate([torque, memory], axis=1))
    return np.stack(found)


@pytest.mark.parametrize("name", ["fuzzy-4", "elastic-observer"])
def test_threads_and_batches_give_what_one_arm_gives(name):
    policy = load_policy(name)
    rows = np.random.default_rng(0).normal(0.0, 0.1, (STEPS, 24, 10))  # motions that no two threads share
    batch = run(policy, rows)
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # s; threads take turns within a call
    try:
        with ThreadPoolExecutor(8) as pool:
            alone = list(pool.map(lambda lane: run(policy, rows[:, lane : lane + 1]), range(24)))
    finally:
        sys.setswitchinterval(usual)
    assert np.array_equal(np.concatenate(alone, axis=1), batch)
