"""The time between samples by their reference, and policies that meet another one than they were made for."""

import copy
import itertools
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.policies import answers

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import chosen_arm
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.fuzzy_policy._sample_clock import _period_between
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy

SLOW = pytest.param("adaptive-observer", "paper", marks=pytest.mark.slow)


def observations(robot, period, count, start=0.0):
    """Return observations (count, 5 n) of the default reference, the motors at 0."""
    sample = default_reference(chosen_arm(robot, None)).sample(start + period * np.arange(count))
    still = np.zeros_like(sample.q)
    return np.hstack([still, still, sample.q, sample.dq, sample.ddq])


@pytest.mark.parametrize("robot", ["paper", "planar-3r", "ur5"])
@pytest.mark.parametrize("period", [1e-4, 1 / 3000, 0.02])
@pytest.mark.parametrize("start", [0.0, 0.3])
def test_two_observations_tell_their_distance_or_nothing(robot, period, start):
    seen = observations(robot, period, 40, start)
    found = np.array([_period_between(*pair) for pair in itertools.pairwise(seen)])
    assert np.count_nonzero(found) >= (20 if period > 1e-4 else 10)
    assert_allclose(found[found > 0.0], period, rtol=2e-4)


def test_what_is_no_motion_tells_nothing():
    generator = np.random.default_rng(0)
    (still,), late = observations("ur5", 1e-3, 1), observations("ur5", 1e-3, 2, 0.5)
    without_velocities = np.hstack([late[:, :-12], np.zeros((2, 12))])
    at_rest, new_episode, backwards = (still, still), (late[1], still), late[::-1]
    for pair in (at_rest, new_episode, backwards, without_velocities, *generator.normal(size=(10_000, 2, 10))):
        assert _period_between(*pair) == 0.0


def errors(policy, period, robot="paper"):
    env = FuzzyArmEnv(control_period=period, robot=robot)
    steps = itertools.islice(episodes(env, policy, env.reset(seed=0)), 40)
    return np.array([step.info["tip_error"] for step in steps])


@pytest.mark.parametrize(("name", "robot"), [("fuzzy-4-tip", "paper"), ("elastic-observer", "cicese"), SLOW])
def test_a_policy_without_a_period_becomes_that_of_the_environment(name, robot):
    policy = load_policy(name, robot=robot)
    assert policy.control_period == 1e-3
    for period in (2e-3, 5e-4):  # the same object, in one environment after the other
        stated = errors(load_policy(name, robot=robot, control_period=period), period, robot)
        assert_allclose(errors(policy, period, robot), stated, rtol=1e-4, atol=1e-9)
        assert policy.control_period == period


def test_lanes_of_a_batch_that_restart():
    envs, policy, state = FuzzyArmVectorEnv(2, control_period=2e-3), load_policy("computed-torque"), None
    observation, _ = envs.reset(seed=0)
    for step in range(5):
        action, state = policy.predict(observation, state, np.array([False, step == 3]))
        observation = envs.step(action)[0]
    assert policy.control_period == 2e-3 and action.shape == (2, 2)


def test_a_policy_that_stays_as_it_is_names_both_periods():
    policy = ComputedTorquePolicy(chosen_arm("paper", None))
    words = r"a control period of 1 ms, but .* 2 ms apart, .*; load the policy with control_period"
    with pytest.warns(RuntimeWarning, match=words) as said:
        errors(policy, 2e-3)
    assert len(said) == 1 and policy.control_period == 1e-3


def test_the_right_period_and_a_sample_that_is_left_out_change_nothing():
    seen, stated = observations("paper", 1e-3, 12), load_policy("elastic-observer", control_period=1e-3)
    left_out, adapting = np.delete(seen, 2, axis=0), load_policy("elastic-observer")
    answers(load_policy("elastic-observer", control_period=1e-3), left_out)  # without a warning
    assert_array_equal(answers(adapting, seen)[0], answers(stated, seen)[0])
    for _ in range(2):  # the period of the last intervals stays
        answers(adapting, left_out)
        assert adapting.control_period == 1e-3


def test_copies_adapt_as_well():
    for policy in (pickle.loads(pickle.dumps(load_policy("fuzzy-4"))), copy.deepcopy(load_policy("fuzzy-4"))):
        answers(policy, observations("paper", 2e-3, 4))
        assert policy.control_period == 2e-3
