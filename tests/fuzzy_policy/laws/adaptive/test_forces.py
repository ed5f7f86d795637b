"""Forces are calm under corrections without a direction, of any size, and open up under those that have one."""

import numpy as np
import pytest

from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import (
    LARGEST_SCALE,
    LATENESS_DOUBT,
    doubt_lateness,
    doubt_scale,
    note_moves,
    spread_out,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

POLICY = AdaptiveObserverPolicy()
SETTINGS, FORCES = POLICY.settings, POLICY.belief.force.stop
FORCE = slice(8, 8 + FORCES)


def corrected(m, corrections):
    """Calm after corrections (samples, forces) [N] of the forces."""
    for correction in corrections:
        before = m.z[FORCE].copy()
        m.z[FORCE] += correction
        note_moves(m, SETTINGS, before)
    return m.flags[FLAG.calm]


@pytest.fixture
def memory():
    return remembered(np.zeros(POLICY.memory.noise.stop), two_joints())


@pytest.mark.parametrize("size", [1e-6, 10.0, 1e4])
def test_noise_of_any_size_leaves_the_forces_calm(memory, size):
    noise = size * np.random.default_rng(0).normal(size=(600, FORCES))
    assert corrected(memory, noise) > 0.7


@pytest.mark.parametrize("size", [1.0, 100.0])
def test_a_direction_ends_the_calm_within_samples_and_opens_the_variance(memory, size):
    memory.flags[FLAG.calm] = 1.0
    assert corrected(memory, np.tile([size, 0.0, 0.0], (12, 1))) < 0.05
    variances = np.diagonal(memory.P)[FORCE]
    np.testing.assert_allclose(variances, SETTINGS.reopening, rtol=0.05)  # the whole of it, in parts


def test_calm_forces_walk_less_and_jumping_torques_are_doubted(memory):
    memory.flags[FLAG.calm] = 1.0
    memory.P[FORCE, FORCE] = np.diag(SETTINGS.noise[FORCE])  # what a prediction adds
    memory.commands[0, 1] = 0.5 * SETTINGS.limit[1]
    spread_out(memory, SETTINGS)
    np.testing.assert_allclose(np.diagonal(memory.P)[FORCE], POLICY.weights.calm_walk**2 * SETTINGS.noise[FORCE])
    added = np.sqrt(np.diagonal(memory.P)[4:6])  # of the motor velocities
    inertia, weights = POLICY.arm.motor_inertia[1], POLICY.weights
    np.testing.assert_allclose(added, [0.0, 1e-3 * weights.torque_doubt * 0.25 * SETTINGS.limit[1] / inertia])


def test_surprise_opens_the_lateness_up_to_its_first_variance(memory):
    first = SETTINGS.spread[-1] ** 2
    memory.P[-1, -1] = 0.01
    doubt_lateness(memory, SETTINGS, 1.0)
    assert memory.P[-1, -1] == 0.01
    doubt_lateness(memory, SETTINGS, 11.0)
    assert memory.P[-1, -1] == pytest.approx(0.01 + 10.0 * LATENESS_DOUBT)
    doubt_lateness(memory, SETTINGS, 1e9)
    assert memory.P[-1, -1] == first


def test_surprise_opens_the_factor_that_the_constants_share(memory):
    shared = SETTINGS.shared > 0.0
    first = memory.P[:] = np.diag(SETTINGS.spread**2)
    first = first.copy()
    doubt_scale(memory, SETTINGS, 1.0)
    np.testing.assert_array_equal(memory.P, first)
    doubt_scale(memory, SETTINGS, 3.0)
    expected = 2.0 * POLICY.weights.scale_doubt * np.outer(shared, shared)
    np.testing.assert_allclose(memory.P - first, expected, atol=1e-15)
    assert np.count_nonzero(shared) == 10  # five factors of two joints
    for _ in range(2):
        doubt_scale(memory, SETTINGS, 1e9)
        assert np.diagonal(memory.P)[shared].min() == pytest.approx(LARGEST_SCALE)
