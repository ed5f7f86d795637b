"""What the limits of the torques do to the integral: nothing within them, and beyond them it does not wind up."""

import copy

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.eval.episodes.rollout import record_rollout

LAWS = ("fuzzy-4", "computed-torque", "fuzzy-4-tip", "computed-torque-tip")
LIMIT = np.array(ArmParameters().torque_limit)


def free(policy):
    """The same policy, whose integral is not held at the limits."""
    other = copy.copy(policy)
    other.integral_at = None
    return other


def observations(error, count=4000):
    """Random observations (count, 10) with errors of the angles up to `error` [rad]."""
    rng = np.random.default_rng(1)
    seen = rng.uniform(-1.0, 1.0, (count, 10))
    seen[:, 4:6] = seen[:, :2] - error * rng.uniform(-1.0, 1.0, (count, 2))
    return seen


@pytest.mark.parametrize("name", LAWS)
def test_the_integral_is_held_exactly_where_it_would_drive_a_torque_further_beyond_its_limit(name):
    policy, seen = load_policy(name), observations(0.3)
    start = np.zeros((len(seen), policy.memory_size))
    start[:, :2] = np.random.default_rng(2).normal(scale=0.02, size=(len(seen), 2))
    torque, state = policy.predict(seen, start)
    wanted, unlimited = np.empty_like(torque), start.copy()
    policy.act(seen, unlimited, wanted)
    change = unlimited[:, :2] - start[:, :2]
    held = (np.abs(wanted) > LIMIT) & (np.sign(change) == -np.sign(wanted))
    assert 100 < held.sum() < held.size - 100
    assert (np.abs(wanted) > LIMIT)[~held].sum() > 100  # beyond a limit, and the integral brings the torque back
    np.testing.assert_array_equal(state[:, :2], np.where(held, start[:, :2], unlimited[:, :2]))
    np.testing.assert_array_equal(state[:, 2:], unlimited[:, 2:])
    np.testing.assert_array_equal(torque, np.clip(wanted, -LIMIT, LIMIT))


def test_a_push_that_the_motors_cannot_hold_is_survived():
    """1000 N for 0.2 s: without the hold the integral winds up and the arm leaves its domain."""
    push = Disturbance(tip_force=ConstantForce((0.0, 1000.0), 0.4, 0.6))
    policy = load_policy("fuzzy-4")
    held, wound = (
        record_rollout(FuzzyArmEnv(disturbance=push), one, policy_name="", case="", seed=0)
        for one in (policy, free(policy))
    )
    assert held.completed and not wound.completed
    assert held.tip_error.max() < 0.1
