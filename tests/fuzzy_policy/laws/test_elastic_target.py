"""The elastic target: compared with the exact reference, and tracked by policies."""

import dataclasses

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import ArmParameters, load_policy, robot_named
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.elastic_reference import ElasticReference
from fuzzyarm.envs.scenario.paths import Lemniscate
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.laws._elastic_target import ElasticTarget

ARM = ArmParameters()
PERIOD = 1e-3


def follow(target, reference, period=PERIOD):
    """Targets (samples, 3 n) and feedforwards (samples, n) along a reference, and the times."""
    t = np.arange(0.0, reference.duration, period)
    motion = reference.sample(t)
    joints = motion.q.shape[1]
    observations = np.hstack([np.full((len(t), 2 * joints), np.nan), *motion])  # the measurement is not read
    memory = np.zeros((1, target.memory_size))
    targets, feedforwards = np.zeros((len(t), 1, 3 * joints)), np.zeros((len(t), 1, joints))
    for k in range(len(t)):
        target.advance(observations[k : k + 1], memory, targets[k], feedforwards[k])
    return t, targets[:, 0], feedforwards[:, 0]


def exact_feedforward(elastic, t, *, friction):
    """u_ff from the exact reference."""
    arm, motor = elastic.reference.parameters, elastic.sample(t)
    torque = np.array(arm.motor_inertia) * motor.ddq + np.array(arm.viscous_friction) * motor.dq + elastic.torque(t)
    dry = DryFriction(np.array(arm.coulomb_friction), np.array(arm.static_friction), arm.stribeck_velocity)
    return torque + friction * stribeck_magnitude(motor.dq, dry) * np.sign(motor.dq)


@pytest.mark.parametrize(
    "reference",
    [
        JointReference(),
        JointReference(Lemniscate((0.4, 0.5), 0.2), duration=2.0),
        JointReference(parameters=dataclasses.replace(ARM, stiffness=(1.2e5, 3e4))),
    ],
)
def test_it_agrees_with_the_exact_reference(reference):
    """But for the first milliseconds, in which the joints settle after the corner at t = 0."""
    t, targets, _ = follow(ElasticTarget(reference.parameters, PERIOD), reference)
    exact = np.hstack(ElasticReference(reference).sample(t))
    bending = np.abs(exact[:, :2] - reference.sample(t).q).max()
    assert bending > 5e-4
    np.testing.assert_allclose(targets[:, :2], exact[:, :2], rtol=0.0, atol=2e-6)
    error = np.abs(targets - exact)[t > 4e-3].max(axis=0)
    assert np.all(error <= np.repeat([2e-8, 5e-6, 5e-3], 2))


@pytest.mark.parametrize("name", slow_but(["planar-3r"], ["planar-3r", "ur5"]))
def test_that_of_a_robot_agrees_with_its_exact_reference(name):
    reference = default_reference(robot_named(name))
    t, found, _ = follow(ElasticTarget(reference.robot, PERIOD), reference)
    late = (t > 0.02) & (t < 0.3)
    exact = ElasticReference(reference).sample(t[late])
    angle, velocity, _ = np.split(found[late], 3, axis=1)
    np.testing.assert_allclose(angle, exact.q, rtol=0, atol=1e-7)
    np.testing.assert_allclose(velocity, exact.dq, rtol=0, atol=5e-5)


def test_the_error_falls_with_the_square_of_the_period():
    """That of θ̈_d, a second difference; on the arm without damping, whose series has one term. Four periods."""
    undamped = dataclasses.replace(ARM, damping=(0.0, 0.0))
    reference, errors, periods = JointReference(parameters=undamped), [], [4e-3, 2e-3, 1e-3, 0.5e-3]
    for period in periods:
        t, targets, _ = follow(ElasticTarget(undamped, period), reference, period)
        late = (t > 0.1) & (t < 1.4)
        errors.append(np.abs(targets[late, 4:] - ElasticReference(reference).sample(t[late]).ddq).max())
    slope = np.polyfit(np.log(periods), np.log(errors), 1)[0]
    assert 1.7 < slope < 2.3


def test_the_feedforward_is_that_of_the_exact_reference():
    reference = JointReference()
    for friction in (False, True):
        t, _, found = follow(ElasticTarget(ARM, PERIOD, friction=friction, average=False), reference)
        exact = exact_feedforward(ElasticReference(reference), t, friction=friction)
        moving = np.abs(ElasticReference(reference).sample(t).dq).min(axis=1) > 1e-3
        kept = (t > 4e-3) & (moving | (not friction))
        np.testing.assert_allclose(found[kept], exact[kept], rtol=0.0, atol=0.01)


@pytest.mark.parametrize("name", ["fuzzy-4", "fuzzy-1", "computed-torque"])
class TestTipPolicy:
    def test_on_the_target_the_torque_is_the_feedforward_and_beside_it_the_feedback_is_that_of_the_law(self, name):
        """Whatever the law's own feedforward knows or not: e = 0 and x_I = 0 leave u_ff."""
        law, tip, reference = load_policy(name), load_policy(f"{name}-tip"), JointReference()
        t, targets, feedforwards = follow(ElasticTarget(ARM, PERIOD), reference)
        k, before, rng, motions = 700, None, np.random.default_rng(0), np.hstack(reference.sample(t))
        for target, motion, feedforward in zip(targets[:k], motions, feedforwards, strict=False):
            torque, before = tip.predict(np.concatenate([target[:4], motion]), before)
            np.testing.assert_allclose(torque, feedforward, rtol=0.0, atol=1e-9)
        on_target, _ = law.predict(np.concatenate([targets[k, :4], targets[k]]))
        for _ in range(5):
            measured, integral = targets[k, :4] + 1e-3 * rng.normal(size=4), 1e-5 * rng.normal(size=2)
            memory = np.concatenate([integral, before[2:]])
            torque, after = tip.predict(np.concatenate([measured, motions[k]]), memory)
            answer, next_integral = law.predict(np.concatenate([measured, targets[k]]), integral)
            np.testing.assert_allclose(torque, answer - on_target + feedforwards[k], rtol=0.0, atol=1e-8)
            np.testing.assert_array_equal(after[:2], next_integral)

    def test_the_sum_is_clipped_once(self, name):
        """Feedback and feedforward of opposite sign beyond the limits cancel before anything is clipped."""
        policy = load_policy(f"{name}-tip")
        motion = np.array([0.5, 1.0, 0.0, 0.0, 200.0, 0.0])  # asks for thousands of N m
        elastic, target, feedforward = ElasticTarget(ARM, PERIOD), np.zeros((1, 6)), np.zeros((1, 2))
        elastic.advance(np.r_[np.zeros(4), motion][np.newaxis], np.zeros((1, elastic.memory_size)), target, feedforward)
        assert np.abs(feedforward).max() > 600.0
        torque, _ = policy.predict(np.concatenate([target[0, :4], motion]))
        np.testing.assert_array_equal(torque, np.clip(feedforward[0], -500.0, 500.0) * [1, 0] + torque * [0, 1])
