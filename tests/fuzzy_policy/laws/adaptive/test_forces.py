"""Forces are calm under corrections without a direction, of any size, and open up under those that have one."""

import numpy as np
import pytest

from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import (
    INSIGNIFICANT,
    Room,
    note_moves,
    significant,
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


@pytest.mark.parametrize("beyond", [0.5, 4.0, 1e4])
@pytest.mark.parametrize("what", ["calm and noise", "no noise", "a direction"])
def test_a_load_within_the_noise_shrinks_by_its_length_and_the_state_is_the_mean_given_it(memory, beyond, what):
    """Without noise, and where corrections have a direction, nothing shrinks."""
    rng, room, load = np.random.default_rng(0), Room(two_joints(), SETTINGS), slice(8, 8 + POLICY.belief.payload.stop)
    root, guess = rng.normal(size=memory.P.shape), SETTINGS.guess[: load.stop - 8]
    memory.P[:], memory.z[:] = root @ root.T, rng.normal(size=len(memory.z))
    memory.flags[FLAG.calm], memory.noise[:] = float(what != "a direction"), 0.0 if what == "no noise" else 1e-10
    room.variances[:] = 8e-10  # an eighth is noise
    off = memory.z[load] - guess
    off *= np.sqrt(beyond * INSIGNIFICANT**2 / 8.0 / (off @ np.linalg.solve(memory.P[load, load], off)))
    memory.z[load] = guess + off
    before = memory.z.copy()
    significant(memory, SETTINGS, room)
    share = max(0.0, 1.0 - 1.0 / beyond) if what == "calm and noise" else 1.0
    np.testing.assert_allclose(room.acted[load] - guess, share * off, atol=1e-12)
    gain = memory.P[:8, load] @ np.linalg.inv(memory.P[load, load])
    np.testing.assert_allclose(room.acted[:8], before[:8] + gain @ (room.acted - before)[load], rtol=1e-9)
    np.testing.assert_array_equal(memory.z, before)  # the filter goes on with what it believes
