"""A law as a policy: one arm alone and many at once give the same bits, from any thread, for a thousand arms."""

import sys
from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import load_policy

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
    policy, envs = (
        load_policy(name, allow_unproven=True),
        gym.make_vec("FuzzyArm-v0", num_envs=LANES, randomisation="plants"),
    )
    observation, info = envs.reset(seed=0)
    assert len(np.unique(info["randomisation"]["mass"], axis=0)) == LANES
    state, worst, halfway = None, np.zeros(LANES), None
    for step in range(1, 1501):
        action, state = policy.predict(observation, state=state)
        observation, _, terminated, truncated, info = envs.step(action)
        assert action.shape == state.shape == (LANES, 2) and not terminated.any()
        assert truncated.all() if step == 1500 else not truncated.any()
        worst = np.maximum(worst, (info["final_info"] if step == 1500 else info)["tip_error"])
        halfway = state if step == 750 else halfway
    assert worst.min() > 1e-3 and worst.max() < 6e-3  # Table 1 itself: 4.2 to 4.6 mm
    assert len(np.unique(halfway, axis=0)) == LANES  # an integral of its own for each
