"""Margins: the assembly on loops solved by hand, the linear prediction against the nonlinear arm."""

import dataclasses
import math

import numpy as np
import pytest
from support.springs import Springs
from support.two_joints import hold

from fuzzyarm import ArmParameters, Robot, load_policy
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, gravity_torque
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.eval.stability._linearisation import LocalLoop, gain_limits, linearise_at, linearise_path
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy

ARM = ArmParameters()
SMOOTH = dataclasses.replace(ARM, static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0))
PERIOD = 1e-3
POSTURE = np.array([0.3, 1.2])
PLANT = slice(0, 8)
POLICIES = {"fuzzy-4": load_policy("fuzzy-4"), "computed-torque": ComputedTorquePolicy(ARM, PERIOD, 50.0)}


def simulate(policy, posture, loop, deviation, steps, gain=1.0, delay=0.0, arm=None):
    """Plant states (steps + 1, 8) less equilibrium, of the friction-free arm started `deviation` away from it."""
    state = (loop.equilibrium[PLANT] + deviation)[:, np.newaxis]
    memory, pending = loop.equilibrium[8:], [loop.torque] * int(2 * delay)  # torques of half periods, oldest first
    lanes, no_force = np.array(flat(arm or arm_constants(SMOOTH)))[:, np.newaxis], np.zeros((4, 1))
    reference = np.concatenate([posture, np.zeros(4)])
    states = state.copy()
    for _ in range(steps):
        action, memory = policy.predict(np.concatenate([state[[0, 1, 4, 5], 0], reference]), state=memory)
        pending += [loop.torque + gain * (action - loop.torque)] * 2
        for _ in range(2):
            hold(state, pending.pop(0)[:, np.newaxis], no_force, lanes, 1e-4, 5)
        states = np.hstack([states, state])
    return np.transpose(states - loop.equilibrium[PLANT, np.newaxis])


def radius(matrix):
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def toy(plant, law, half_plant=None):
    """A loop from plain lists; its equilibrium is the origin, and without half a period it has no half delays."""
    half = np.full(np.shape(plant), math.nan) if half_plant is None else np.array(half_plant, float)
    return LocalLoop(np.array(plant, float), half, np.array(law, float), np.zeros(0), np.zeros(0))


def stiffer(factor):
    return dataclasses.replace(ARM, stiffness=(factor * ARM.stiffness[0], factor * ARM.stiffness[1]))


def linearised(policy, arm=ARM, payload=None):
    """The loop at its equilibrium near the posture."""
    return linearise_at(policy, arm, POSTURE, PERIOD, payload)[0]


# x⁺ = x + u, u = -x/2, and the same with an integral: u = -x/2 - s/10, s⁺ = s + x.
INTEGRATOR = toy([[1, 1]], [[-0.5]], [[1, 0.5]])
WITH_INTEGRAL = toy([[1, 1]], [[-0.5, -0.1], [1, 1]])


@pytest.mark.parametrize("gain", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_characteristic_polynomials(gain, delay):
    """z^d (z - 1) + κ/2 without, z^d (z - 1)² + κ (z/2 - 1/2 + 1/10) with memory.

    Between samples, half a period x⁺ = x/2 + u and a delay d + 1/2: x⁺ = x/4 + u_(k-d-1)/2 + u_(k-d), u = -κ x/2 has
    z^(d+2) - z^(d+1)/4 + κ/2 z + κ/4: the older torque acts first, and fades for half a period more.
    """
    power, between = [1.0] + [0.0] * delay, toy([[0.25, 1.5]], [[-0.5]], [[0.5, 1]])
    for matrix, free, driven in (
        (INTEGRATOR.matrix(gain, delay), [1, -1], [0.5]),
        (WITH_INTEGRAL.matrix(gain, delay), [1, -2, 1], [0.5, -0.4]),
        (between.matrix(gain, delay + 0.5), [1, -0.25, 0], [0.5, 0.25]),
    ):
        expected = np.polyadd(np.polymul(power, free), np.multiply(gain, driven))
        np.testing.assert_allclose(np.poly(matrix), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("loop", "delay", "limits"),
    [
        (INTEGRATOR, 0, (0.0, 4.0)),
        (INTEGRATOR, 0.5, (0.0, 4.0)),
        (INTEGRATOR, 1, (0.0, 2.0)),
        (INTEGRATOR, 1.5, (0.0, 4.0 * (math.sqrt(2.0) - 1.0))),
        (INTEGRATOR, 2, (0.0, math.sqrt(5.0) - 1.0)),
        (toy([[1.2, 1]], [[-0.5]]), 0, (0.4, 4.4)),
        (toy([[0.9, 0]], [[-0.5]]), 0, (0.0, math.inf)),
    ],
)
def test_gain_limits(loop, delay, limits):
    """Solved by hand for |z| = 1: an integrator, a conditionally stable loop, and one without an input."""
    assert gain_limits([loop], delay) == pytest.approx(limits, rel=2e-4)


@pytest.mark.parametrize(
    ("plant", "payload", "gain", "delay"),
    [
        *((ARM, None, gain, delay) for gain, delay in ((1.0, 0), (1.5, 0), (1.0, 0.5), (1.0, 1), (0.7, 1.5), (0.7, 2))),
        (stiffer(0.8), None, 1.0, 0),
        (dataclasses.replace(ARM, viscous_friction=(50.0, 20.0)), None, 1.0, 0),
        (ARM, Payload(5.0), 1.0, 0.5),
    ],
)
@pytest.mark.parametrize("name", POLICIES)
def test_the_matrix_power_predicts_the_nonlinear_arm(name, plant, payload, gain, delay):
    """A deviation of about 0.01 mrad over 200 periods, in units in which angles and velocities weigh alike."""
    policy = POLICIES[name]  # which knows the nominal arm only
    loop = linearised(policy, plant, payload)
    deviation = np.array([10.0, -5.0, 8.0, -7.0, 30.0, 200.0, -100.0, 50.0]) * 1e-6
    matrix = loop.matrix(gain, delay)
    start = np.concatenate([deviation, np.zeros(len(matrix) - 8)])
    predicted = np.array([np.linalg.matrix_power(matrix, k)[PLANT] @ start for k in range(201)])
    arm = arm_constants(dataclasses.replace(plant, static_friction=(0, 0), coulomb_friction=(0, 0)), payload)
    simulated = simulate(policy, POSTURE, loop, deviation, 200, gain, delay, arm)
    weights = np.repeat([1.0, 0.02], 4)
    size = np.linalg.norm(predicted * weights, axis=1)
    assert size[200] < 0.3 * size.max()
    assert np.all(np.linalg.norm((simulated - predicted) * weights, axis=1) <= 0.02 * size + 1e-11)


@pytest.mark.slow
def test_a_robot_has_the_loops_of_the_two_joint_arm_that_it_is():
    """The same arm by its parameters and as a robot, whose equations are generated: equal loops, with a payload."""
    arms = ARM, Robot.of(ARM)
    expected, found = (linearised(ComputedTorquePolicy(arm, PERIOD, 50.0), arm, Payload(5.0)) for arm in arms)
    np.testing.assert_allclose(found.equilibrium, expected.equilibrium, atol=1e-10)
    np.testing.assert_allclose(found.torque, expected.torque, atol=1e-6)
    for delay in (0.0, 0.5, 1.0):
        assert radius(found.matrix(delay=delay)) == pytest.approx(radius(expected.matrix(delay=delay)), abs=1e-6)


class FrictionModel(Springs):
    """`Springs` that add the friction they expect, 4 and 2 N m against the motors' velocity; steep at rest."""

    designs = 0

    def predict(self, observation, state=None, *_, **__):
        torque, memory = super().predict(observation, state)
        return torque + np.array([4.0, 2.0]) * np.tanh(observation[..., 2:4] / 1e-3), memory

    def without_dry_friction(self):
        self.designs += 1
        return Springs()


def test_a_model_of_dry_friction_is_removed_with_the_friction():
    policy = FrictionModel()
    plain, modelled = (linearise_path(each, ARM, PERIOD) for each in (Springs(), policy))
    assert policy.designs == 1
    np.testing.assert_array_equal([loop.matrix() for loop in modelled], [loop.matrix() for loop in plain])


def test_equilibrium_of_a_loop_with_integral():
    loop = linearised(POLICIES["fuzzy-4"])
    motor, link = loop.equilibrium[:2], loop.equilibrium[2:4]
    gravity = gravity_torque(np.sin(link[0]), np.sin(link.sum()), arm_constants(ARM))
    np.testing.assert_allclose(motor, POSTURE, atol=1e-9)
    np.testing.assert_allclose(motor - link, np.divide(gravity, ARM.stiffness), atol=1e-10)
    np.testing.assert_allclose(loop.torque, gravity, atol=1e-6)
    np.testing.assert_allclose(loop.equilibrium[4:8], 0.0, atol=1e-9)


@pytest.mark.parametrize(("name", "delay"), [("fuzzy-4", 0), ("fuzzy-4", 0.5), ("computed-torque", 1)])
def test_the_arm_settles_below_the_upper_margin_and_diverges_above(name, delay, few_postures):
    """At the posture that is the first to go, 3 % to either side."""
    policy = POLICIES[name]
    loops = linearise_path(policy, ARM, PERIOD)
    upper = gain_limits(loops, delay).upper
    loop = max(loops, key=lambda loop: radius(loop.matrix(1.01 * upper, delay)))
    posture, deviation = loop.equilibrium[:2], np.repeat([1e-7, 0.0], 4)  # with an integral it is the reference
    below, above = (simulate(policy, posture, loop, deviation, 1500, k * upper, delay) for k in (0.97, 1.03))
    assert np.abs(below[-50:]).max() < 1e-2 * np.abs(below).max()
    assert np.abs(above[-50:]).max() > 1e3 * np.abs(above[:50]).max()


def test_memory_that_the_torque_does_not_read_is_left_out():
    """A call counter adds no eigenvalue 1: the loop is that of the policy without memory, motors bent off."""

    def count_calls(observation, state):
        return np.zeros((len(observation), 1)) if state is None else state + 1.0

    plain, counting = (linearised(Springs(memory)) for memory in (None, count_calls))
    np.testing.assert_array_equal(counting.matrix(), plain.matrix())
    assert plain.matrix().shape == (8, 8) and radius(plain.matrix()) < 1.0
    assert 1e-5 < np.abs(plain.equilibrium[:2] - POSTURE).max() < 1e-2


WEAK = dataclasses.replace(ARM, torque_limit=(20.0, 10.0))


@pytest.mark.parametrize(
    ("policy", "plant", "message"),
    [
        (Springs(lambda *_: (0, 0)), ARM, "state of type tuple"),
        (Springs(dtype=np.float32), ARM, "float32"),
        (Springs(), WEAK, "limit"),
        (ComputedTorquePolicy(WEAK, PERIOD, 50.0), ARM, "no equilibrium"),
        (Springs(), stiffer(1e7), "overflow at posture"),  # far too stiff for the sub-step
    ],
)
def test_policies_that_cannot_be_linearised_are_refused(policy, plant, message, monkeypatch):
    if "overflow" in message:
        monkeypatch.setattr("fuzzyarm.eval.stability._linearisation.fastest_rate", lambda arms: 0.0)
    with pytest.raises((TypeError, ValueError), match=message):
        linearised(policy, plant)
