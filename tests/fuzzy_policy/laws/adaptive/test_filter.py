"""The filter's two steps against textbook formulas in NumPy, and the law's functions of the arm against the physics."""

import numpy as np
import pytest

from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.fuzzy_policy.known_arm import drives_of
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import (
    FLAG,
    AdaptiveWeights,
    ArmFunctions,
    affine_numbers,
    belief_of,
    layout,
    numbers_of,
    prior,
    remembered,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import (
    NOISE_SHARE,
    Room,
    confine,
    note_noise,
    spread_copies,
    step,
    update,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

ARM = ArmParameters()
BELIEF, FUNCTIONS = belief_of(two_joints()), ArmFunctions(two_joints())
hold = FUNCTIONS.hold
BELIEFS, FORCES = BELIEF.lateness.stop, BELIEF.force.stop
SETTINGS, GUESS = AdaptiveObserverPolicy().settings, prior(ARM, AdaptiveWeights()).guess
STATES, SIZE = 8, 8 + BELIEFS
MEASURED = [0, 1, 4, 5]
NO_GATE, NOTHING_SILENT = 1e300, np.zeros(4)


def believing(z, P):
    """A memory with copies of z and P, and room."""
    m = remembered(np.zeros(layout(two_joints()).noise.stop), two_joints())
    m.z[:], m.P[:] = z, P
    return m, Room(two_joints(), SETTINGS)


def covariance(rng, scale=1.0):
    root = scale * rng.normal(size=(SIZE, SIZE))
    return root @ root.T / SIZE


def corrected(z, P, measured, variances, silent=NOTHING_SILENT, cautious=None, gate=NO_GATE):
    """z and P after a correction, the arguments left alone."""
    m, room = believing(z, P)
    room.measured, room.variances, room.silent = measured, variances, silent
    cautious = np.zeros(SIZE) if cautious is None else cautious.astype(float)
    surprise = update(m, SETTINGS.replaced(cautious=cautious, gate=gate), room)
    return m.z, m.P, surprise


def test_whole_correction_is_the_joint_kalman_update():
    rng = np.random.default_rng(1)
    z, P, measured = rng.normal(size=SIZE), covariance(rng), rng.normal(size=4)
    variances = rng.uniform(0.1, 1.0, 4)
    C = np.eye(SIZE)[MEASURED]
    gain = P @ C.T @ np.linalg.inv(C @ P @ C.T + np.diag(variances))
    found, left, _ = corrected(z, P, measured, variances)
    np.testing.assert_allclose(found, z + gain @ (measured - C @ z), atol=1e-12)
    np.testing.assert_allclose(left, P - gain @ C @ P, atol=1e-12)


def test_constants_do_not_learn_within_the_dead_zone_and_states_do():
    rng = np.random.default_rng(2)
    z, P, cautious = rng.normal(size=SIZE), covariance(rng), np.arange(SIZE) >= STATES
    measured, variances = z[MEASURED] + 0.01, np.full(4, 0.1)
    found, left, _ = corrected(z, P, measured, variances, np.full(4, 1.0), cautious)
    np.testing.assert_array_equal(found[STATES:], z[STATES:])
    np.testing.assert_array_equal(left[STATES:, STATES:], P[STATES:, STATES:])
    whole, smaller, _ = corrected(z, P, measured, variances)
    np.testing.assert_allclose(found[0], whole[0], rtol=0.2)
    assert np.all(np.linalg.eigvalsh(left) > -1e-12)
    assert np.trace(smaller) < np.trace(left) < np.trace(P)


def test_partial_correction_lies_between_none_and_a_whole_one():
    rng = np.random.default_rng(3)
    z, P, cautious = rng.normal(size=SIZE), covariance(rng), np.arange(SIZE) >= STATES
    measured, silent = z[MEASURED].copy(), np.full(4, 0.5)
    measured[0] += 1.0  # the dead zone takes half of this correction
    silent[1:] = 0.0
    only_first = np.array([0.1, 1e30, 1e30, 1e30])
    found, left, _ = corrected(z, P, measured, only_first, silent, cautious)
    whole, smaller, _ = corrected(z, P, measured, only_first)
    np.testing.assert_allclose(found[STATES:] - z[STATES:], 0.5 * (whole - z)[STATES:], rtol=1e-9)
    shrunk, shrink = (P - left)[STATES:, STATES:], (P - smaller)[STATES:, STATES:]
    np.testing.assert_allclose(shrunk, 0.75 * shrink, rtol=1e-9)
    assert np.all(np.linalg.eigvalsh(left) > -1e-12)


def test_gate_bounds_what_a_sample_may_do():
    rng = np.random.default_rng(4)
    z, P = rng.normal(size=SIZE), covariance(rng)
    near, far = z[MEASURED].copy(), z[MEASURED].copy()
    near[0], far[0] = near[0] + 100.0, far[0] + 200.0
    variances = np.array([0.1, 1e30, 1e30, 1e30])
    moved, moved_more = (corrected(z, P, y, variances, gate=4.0)[0] - z for y in (near, far))
    np.testing.assert_allclose(moved_more, 0.5 * moved, rtol=1e-6)  # 4/ν instead of ν/s


def test_confining_a_number_moves_the_others_as_their_covariance_says():
    rng = np.random.default_rng(5)
    P = covariance(rng)
    z = np.zeros(SIZE)
    low, high = np.full(BELIEFS, -1e3), np.full(BELIEFS, 1e3)
    z[-1], low[-1] = -1.0, 0.0
    expected = z + P[:, -1] / P[-1, -1]
    m, _ = believing(z, P)
    confine(m, SETTINGS.replaced(low=low, high=high))
    np.testing.assert_allclose(m.z, expected, atol=1e-12)


def read_from(angle, velocity, period=1e-3):
    """What `note_noise` has read after the last sample, and at each of them."""
    (m, room), found = believing(np.zeros(SIZE), np.zeros((SIZE, SIZE))), []
    m.read[:], m.flags[FLAG.samples] = (angle[0], velocity[0], -period * velocity[0]), 1.0 / NOISE_SHARE + 2.0
    for room.measured in np.column_stack([angle, velocity]).reshape(len(angle), 4):
        note_noise(m, SETTINGS.replaced(substep=period, substeps=1), room)
        found.append(m.noise.copy())
    return np.array(found)


def test_noise_that_is_read_converges_to_the_variance_and_ignores_a_smooth_motion():
    rng = np.random.default_rng(6)
    time = 1e-3 * np.arange(3000)[:, np.newaxis] * np.ones(2)
    angle, velocity = 0.5 * np.sin(6.0 * time), 3.0 * np.cos(6.0 * time)
    for sigma in (1e-5, 3e-5):
        noise = sigma * rng.normal(size=(2, *time.shape))
        found = read_from(angle + noise[0], velocity + 100.0 * noise[1])
        assert np.mean(found[500:]) == pytest.approx(sigma**2, rel=0.1)


def test_noise_that_is_read_is_blind_to_what_held_torques_do():
    period, steps = 1e-3, 400
    jolts = 200.0 * np.random.default_rng(8).normal(size=(steps, 2))  # rad/s², another one every period
    velocity = np.cumsum(np.vstack([np.zeros((1, 2)), period * jolts]), axis=0)
    angle = np.cumsum(np.vstack([np.zeros((1, 2)), period * velocity[:-1] + 0.5 * period**2 * jolts]), axis=0)
    assert np.sqrt(read_from(angle, velocity)[-1]).max() < 1e-12
    assert np.diff(angle, 3, axis=0).std() > 1e-5  # a third difference would take them for noise


def moved(z, torque, directions, base, slopes):
    """x after a control period by the compiled plant, for one z."""
    state = z[:STATES, np.newaxis].copy()
    force = np.ascontiguousarray((directions @ z[STATES : STATES + FORCES])[:, np.newaxis])
    constants = np.ascontiguousarray((base + slopes @ (z[STATES:] - GUESS))[:, np.newaxis])
    hold(state, np.ascontiguousarray(torque[:, np.newaxis]), force, constants, 2e-4, 5)
    return state[:, 0]


@pytest.mark.slow
def test_prediction_is_the_plants_own_and_the_covariance_f_p_ft_plus_q():
    rng = np.random.default_rng(7)
    base, slopes = affine_numbers(ARM)
    z = np.concatenate([[0.3, 1.0, 0.299, 0.998, 1.0, -1.5, 1.01, -1.49], GUESS])
    z[STATES:][BELIEF.payload], z[STATES : STATES + FORCES] = 2.0, (20.0, -5.0, 7.0)
    P, noise, torque, slope = covariance(rng, 1e-4), rng.uniform(0.0, 1e-8, SIZE), np.array([90.0, -20.0]), np.ones(2)
    directions = np.zeros((4, FORCES))
    directions[0, 1] = directions[1, 2] = 1.0
    directions[:2, 0] = 0.6, 0.8
    steps = np.concatenate([np.full(4, 1e-7), np.full(4, 1e-6), np.full(BELIEFS, 1e-4)])
    F = np.zeros((STATES, SIZE))
    for j in range(SIZE - 1):
        away = np.zeros(SIZE)
        away[j] = 1e-5
        ahead, behind = (moved(z + sign * away, torque, directions, base, slopes) for sign in (1.0, -1.0))
        F[:, j] = (ahead - behind) / 2e-5
    late = (moved(z, torque + sign * slope, directions, base, slopes) for sign in (1.0, -1.0))
    F[:, -1] = (next(late) - next(late)) / 2.0
    whole = np.vstack([F, np.eye(SIZE)[STATES:]])
    expected = whole @ P @ whole.T + np.diag(noise)
    m, room = believing(z, P)
    s = SETTINGS.replaced(steps=steps, noise=noise)
    room.directions[:], room.numbers[:] = directions, base + slopes @ (z[STATES:] - GUESS)
    spread_copies(m, s, room, torque, slope)
    hold(*room.copies, 2e-4, 5)
    step(m, s, room)
    found, left = m.z, m.P
    np.testing.assert_array_equal(found[:STATES], moved(z, torque, directions, base, slopes))
    np.testing.assert_array_equal(found[STATES:], z[STATES:])
    np.testing.assert_allclose(left, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_functions_of_six_joints_are_those_of_the_robot_with_its_payload():
    rng, robot = np.random.default_rng(9), robot_named("ur5")
    physics, loaded = equations_of(robot), robot.with_payload(2.0)
    functions, numbers = ArmFunctions(physics), numbers_of(robot, 2.0)
    (q, dq, ddq), force, torque, direction = rng.normal(size=(3, 6)), rng.normal(size=3), np.empty(6), np.empty(3)
    torque = np.array(functions.link_torque(q, dq, ddq, force, functions.constants_in(numbers)))
    J = rigid_body.tip_jacobian(robot, q)
    np.testing.assert_allclose(torque, rigid_body.inverse_dynamics(loaded, q, dq, ddq) - J.T @ force, atol=1e-10)
    direction = np.array(functions.tip_direction(q, dq, functions.constants_in(numbers)))
    np.testing.assert_allclose(direction, J @ dq / np.linalg.norm(J @ dq), atol=1e-12)
    drives = np.array([flat(functions.drive(numbers, j)) for j in range(6)])
    np.testing.assert_array_equal(drives.T, drives_of(robot))
