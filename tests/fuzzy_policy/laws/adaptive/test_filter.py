"""The filter's two steps against textbook formulas in NumPy, and the law's functions of the arm against the physics."""

import numpy as np
import pytest
from support.policies import remembered

from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import (
    FLAG,
    AdaptiveWeights,
    ArmFunctions,
    affine_numbers,
    belief_of,
    layout,
    prior,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import (
    _NOISE_SHARE,
    Room,
    _confine,
    _note_noise,
    _spread_copies,
    _step,
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


def test_confining_a_number_moves_the_others_as_their_covariance_says():
    rng = np.random.default_rng(5)
    P = covariance(rng)
    z = np.zeros(SIZE)
    low, high = np.full(BELIEFS, -1e3), np.full(BELIEFS, 1e3)
    z[-1], low[-1] = -1.0, 0.0
    expected = z + P[:, -1] / P[-1, -1]
    m, _ = believing(z, P)
    _confine(m, SETTINGS.replaced(low=low, high=high))
    np.testing.assert_allclose(m.z, expected, atol=1e-12)


def read_from(angle, velocity, period=1e-3):
    """What `_note_noise` has read after the last sample, and at each of them."""
    (m, room), found = believing(np.zeros(SIZE), np.zeros((SIZE, SIZE))), []
    m.read[:], m.flags[FLAG.samples] = (angle[0], velocity[0], -period * velocity[0]), 1.0 / _NOISE_SHARE + 2.0
    for room.measured in np.column_stack([angle, velocity]).reshape(len(angle), 4):
        _note_noise(m, SETTINGS.replaced(substep=period, substeps=1), room)
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
    _spread_copies(m, s, room, torque, slope)
    hold(*room.copies, 2e-4, 5)
    _step(m, s, room)
    found, left = m.z, m.P
    np.testing.assert_array_equal(found[:STATES], moved(z, torque, directions, base, slopes))
    np.testing.assert_array_equal(found[STATES:], z[STATES:])
    np.testing.assert_allclose(left, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())
