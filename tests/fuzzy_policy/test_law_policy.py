"""A law as a policy: one arm alone and many at once give the same bits, from any thread, for a thousand arms."""

import sys
from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import load_policy
from fuzzyarm.eval.episodes.loop import TipErrors, episodes

STEPS, LANES = 200, 1024


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


@pytest.mark.parametrize("name", slow_but(["fuzzy-4"], ["fuzzy-4", "fuzzy-32", "computed-torque"]))
def test_a_thousand_different_arms_are_tracked_to_the_end(name):
    envs, errors = gym.make_vec("FuzzyArm-v0", num_envs=LANES, randomisation="plants"), TipErrors(LANES)
    observation, info = envs.reset(seed=0)
    assert len(np.unique(info["randomisation"]["mass"], axis=0)) == LANES
    for step in episodes(envs, load_policy(name, allow_unproven=True), (observation, info)):
        errors.add(step)
    assert errors.completed.all() and np.all(errors.steps == 1500)
    assert errors.largest.min() > 1e-3 and errors.largest.max() < 6e-3  # Table 1 itself: 4.2 to 4.6 mm
    assert step.memory.shape == np.unique(step.memory, axis=0).shape == (LANES, 2)  # an integral of its own for each
