"""Again over the same path: errors fall from pass to pass, another path is noticed, states are checked."""

import gymnasium as gym
import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.laws.adaptive._passes import _Smoother, _steadiest
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

POLICY = AdaptiveObserverPolicy()
LOADS = [
    Disturbance(tip_force=ConstantForce((0.0, 150.0), 0.1, 0.3)),
    Disturbance(payload=Payload(4.0)),
    Disturbance(),
]
SHORT = JointReference(duration=0.8, path=Circle(radius=0.06))


def run(repeated, state, reference=SHORT, **others):
    """Tip errors [mm] (steps, lanes) of one pass, and the state after it."""
    envs = gym.make_vec("FuzzyArm-v0", num_envs=len(LOADS), disturbance=LOADS, reference=reference, **others)
    observation, _ = envs.reset(seed=0)
    errors = []
    for _ in range(int(1000 * reference.duration) - 1):
        torque, state = repeated.predict(observation, state)
        observation, _, terminated, _, info = envs.step(torque)
        assert not terminated.any()
        errors.append(1e3 * info["tip_error"])
    return np.array(errors), state


def test_the_first_pass_is_the_policy_itself_bit_for_bit():
    envs = gym.make_vec("FuzzyArm-v0", num_envs=len(LOADS), disturbance=LOADS)
    observation, _ = envs.reset(seed=0)
    repeated, state, kept = POLICY.repeated(), None, None
    for _ in range(20):
        alone, kept = POLICY.predict(observation, kept)
        torque, state = repeated.predict(observation, state)
        np.testing.assert_array_equal(torque, alone)
        observation, *_ = envs.step(torque)


@pytest.mark.slow
def test_errors_fall_from_pass_to_pass():
    largest = {}
    for name, repeated in (("own", POLICY.repeated()), ("iterative", load_policy("fuzzy-4-tip").repeated())):
        state, largest[name] = None, []
        for _ in range(3):
            errors, state = run(repeated, state)
            largest[name].append(errors.max(axis=0))
            state = repeated.begin_pass(state)
    first, second, third = np.array(largest["own"])
    assert np.all(second[:2] < 0.45 * first[:2]) and np.all(third[:2] < 0.35 * first[:2])
    assert third[2] < 0.01  # without a load there is nothing to learn
    first, _, third = np.array(largest["iterative"])  # it brings the motors home and not the tip
    assert third[0] < first[0] and third[1] > 0.5


@pytest.mark.slow
def test_with_the_true_constants_the_true_force_explains_a_pass():
    repeated, payload = POLICY.repeated(), [load.payload.mass for load in LOADS]
    _, state = run(repeated, None)
    known = state.memory.copy()
    known[:, repeated._constants] = POLICY.settings.guess
    known[:, repeated._payload] = payload
    force = _Smoother(POLICY).force(state, np.ones(len(LOADS), dtype=bool), known)
    truth = np.zeros_like(force)
    truth[100:300, 0] = 0.0, 150.0
    away = np.r_[20:80, 130:270, 330:760]  # from the jumps of the force and from the ends
    assert np.abs(force - truth)[away].max() < 4.0
    found = POLICY.beliefs(repeated.begin_pass(state).memory).payload
    np.testing.assert_allclose(found, payload, atol=0.4)


def test_the_steadiest_force_varies_least_in_total():
    generator = np.random.default_rng(3)
    force, slope = generator.normal(size=(2, 60, 4, 2)).cumsum(axis=1)
    force[30:] += 20.0  # a jump counts once, however high it is

    def variation(x):
        return np.linalg.norm(np.diff(force + x * slope, axis=0), axis=2).sum(axis=0)

    found = _steadiest(force, slope)
    least = variation(found[:, np.newaxis])
    for step in (-0.02, 0.02):
        assert np.all(variation((found + step)[:, np.newaxis]) > least)


@pytest.mark.slow
def test_on_another_path_nothing_is_expected():
    repeated = POLICY.repeated()
    _, state = run(repeated, None)
    state = repeated.begin_pass(state)
    other = JointReference(duration=0.8, path=Circle(radius=0.05))
    errors, state = run(repeated, state, other)
    assert state.other_path.all()
    assert errors.max() < 5.0
    fresh = repeated.begin_pass(state)
    assert np.all(fresh.expected == 0.0) and np.all(fresh.passes == 0)


def test_without_a_sample_there_is_no_pass_to_learn_from():
    for repeated in (POLICY.repeated(), load_policy("fuzzy-4-tip").repeated()):
        _, state = repeated.predict(np.zeros((3, 10)))
        with pytest.raises(ValueError, match="no pass to learn from"):
            repeated.begin_pass(repeated.begin_pass(state))
    assert load_policy("elastic-observer").repeated() is None
