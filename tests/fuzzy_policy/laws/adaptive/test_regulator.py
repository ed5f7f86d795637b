"""The share of the gain with which an episode begins; the table itself is tested with the laws that use it."""

import numpy as np
import pytest

from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, AdaptiveWeights, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.law import gain_share
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy


def shares(samples, *, taught=0.0, **weights):
    policy = AdaptiveObserverPolicy(weights=AdaptiveWeights(**weights))
    memory = remembered(np.zeros(policy.memory.noise.stop), two_joints())
    memory.flags[FLAG.taught], found = taught, []
    for sample in samples:
        memory.flags[FLAG.samples] = sample
        found.append(gain_share(memory, policy.settings))
    return np.array(found)


def test_the_gain_waits_then_grows_in_as_long_again():
    found = shares(range(1, 101), first_gain=0.4, soft_start=0.02)
    np.testing.assert_array_equal(found[:21], 0.4)
    np.testing.assert_allclose(found[20:41], np.linspace(0.4, 1.0, 21))
    np.testing.assert_array_equal(found[40:], 1.0)


@pytest.mark.parametrize("options", [{"first_gain": 1.0}, {"first_gain": 0.4, "taught": 1.0}])
def test_it_is_whole_from_the_first_sample_if_asked_for_or_after_a_pass(options):
    np.testing.assert_array_equal(shares(range(1, 50), **options), 1.0)
