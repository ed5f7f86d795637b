"""What the law acts on: the load beyond the noise that is read, and the state that fits it."""

import numpy as np
import pytest

from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import INSIGNIFICANT, Room, significant
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

POLICY = AdaptiveObserverPolicy()
SETTINGS, STATES = POLICY.settings, 8
LOAD = slice(STATES, STATES + POLICY.belief.payload.stop)


@pytest.fixture
def believed():
    """A memory with a calm load, a covariance without structure, and the room; an eighth of the variance is noise."""
    rng = np.random.default_rng(0)
    m = remembered(np.zeros(POLICY.memory.noise.stop), two_joints())
    root = rng.normal(size=m.P.shape)
    m.P[:] = root @ root.T
    m.z[:] = rng.normal(size=len(m.z))
    m.flags[FLAG.calm], m.noise[:] = 1.0, (1e-10, 0.5e-10)
    room = Room(two_joints(), SETTINGS)
    room.variances[:] = 8e-10
    return m, room


@pytest.mark.parametrize("beyond", [0.5, 1.0, 4.0, 1e4])
def test_the_load_shrinks_by_its_length_and_the_state_is_the_mean_given_it(believed, beyond):
    m, room = believed
    guess = SETTINGS.guess[: LOAD.stop - STATES]
    off = m.z[LOAD] - guess
    square = off @ np.linalg.solve(m.P[LOAD, LOAD], off)
    m.z[LOAD] = guess + off * np.sqrt(beyond * INSIGNIFICANT**2 / 8.0 / square)
    before = m.z.copy()
    significant(m, SETTINGS, room)
    acted = room.acted
    np.testing.assert_allclose(acted[LOAD] - guess, max(0.0, 1.0 - 1.0 / beyond) * (before[LOAD] - guess), atol=1e-12)
    gain = m.P[:STATES, LOAD] @ np.linalg.inv(m.P[LOAD, LOAD])
    np.testing.assert_allclose(acted[:STATES], before[:STATES] + gain @ (acted[LOAD] - before[LOAD]), rtol=1e-9)
    np.testing.assert_array_equal(acted[LOAD.stop :], before[LOAD.stop :])
    np.testing.assert_array_equal(m.z, before)  # the filter goes on with what it believes


@pytest.mark.parametrize("what", ["noise", "calm", "known for certain"])
def test_without_noise_and_where_corrections_have_a_direction_nothing_shrinks(believed, what):
    m, room = believed
    if what == "noise":
        m.noise[:] = 0.0
    elif what == "calm":
        m.flags[FLAG.calm] = 0.0
    else:
        m.P[LOAD, :], m.P[:, LOAD], m.z[LOAD] = 0.0, 0.0, SETTINGS.guess[: LOAD.stop - STATES]
    significant(m, SETTINGS, room)
    np.testing.assert_allclose(room.acted, m.z, rtol=1e-12)
