"""Actions beside the elastic observer: the gate, what the observer knowsand its innovation as features."""

import numpy as np
from support.bundles import bundle

from fuzzyarm import load_policy
from fuzzyarm.envs.observation import observed
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition
from fuzzyarm.fuzzy_policy.laws.learned.features import Base, Features, Lanes, gate
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy

BESIDE = ActionDefinition(scale=(30.0, 20.0), period=1e-3, base="elastic-observer", gate=2.0)
TIMES = (0.002, 0.01)


def beside():
    """A policy beside the observer, with a random network."""
    return LearnedPolicy(bundle(BESIDE, innovation_times=TIMES), 1e-3, base=load_policy("elastic-observer"))


def observations(calls=5, lanes=3):
    """Motors that hardly move beside a reference at rest."""
    rng = np.random.default_rng(0)
    shown = np.zeros((calls, lanes, 10))
    observed(shown).q_motor[:] = [0.4, 0.9] + 3e-6 * rng.normal(size=(calls, lanes, 2))
    observed(shown).q_reference[:] = [0.4, 0.9]
    return shown


def test_the_gate_is_the_mean_square_of_the_innovation_in_its_units_over_one_more():
    innovation = np.array([[0.0, 0.0, 0.0, 0.0], [2e-6, -2e-6, 4e-3, -4e-3], [4e-9, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(gate(innovation.T, 2.0), [0.0, 0.5, 1e-6], rtol=1e-5)


def test_the_action_is_a_torque_of_which_the_observer_knows():
    policy, state = beside(), None
    base = policy.base
    memory, torque = np.zeros((3, base.memory_size)), np.empty((3, 2))
    own = Features(policy.bundle.features, 1e-3)
    lanes = Lanes(own, Base(base, policy.bundle.action))
    past, action = np.zeros((3, own.memory_size)), np.empty((3, 2))
    means = np.zeros((2, 3, 4))
    for observation in observations():
        arm, load = base.estimate(memory)
        innovation = np.where(memory.any(), observation[:, :4] - arm[:, [0, 1, 4, 5]], 0.0)
        features = lanes.see(observation, past, memory)
        shares = 1.0 - np.exp(-1e-3 / np.array(TIMES))
        means += shares[:, np.newaxis, np.newaxis] * (innovation - means)
        units = np.array([1e-6, 1e-6, 2e-3, 2e-3])
        expected = np.arcsinh(
            np.concatenate([innovation / units, innovation / (20.0 * units), *(means / units)], axis=1)
        )
        np.testing.assert_allclose(features[:, -18:-2], expected, rtol=1e-12, atol=1e-13)
        assert np.array_equal(features[:, -2:], load / 100.0)
        policy.bundle.network.act(features, action)
        extra = gate(innovation.T, 2.0)[:, np.newaxis] * [30.0, 20.0] * action
        alone, silent = memory.copy(), np.empty((3, 2))
        base.command(observation, alone, silent)
        torque[:] = [30.0, 20.0] * action
        lanes.act(observation, action, torque, past, memory)
        found, state = policy.predict(observation, state)
        np.testing.assert_allclose(found, torque, rtol=1e-12)
        np.testing.assert_allclose(found, silent + extra, rtol=1e-9, atol=1e-9)
    gained = (base.estimate(memory)[0] - base.estimate(alone)[0])[:, 4:6]  # velocities of the motors
    assert np.abs(gained).max() > 1e-3 and (gained * extra >= 0.0).all()
