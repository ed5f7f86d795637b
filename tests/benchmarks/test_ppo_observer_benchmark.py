"""How `ppo_observer.py` makes torques half a sample late."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")


@pytest.fixture
def script(module):
    """The script, which imports its neighbours."""
    return module("ppo_observer")


class Counting:
    """A policy whose torque is the number of its call."""

    calls = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        return np.full((1, 2), float(self.calls)), state


@pytest.mark.slow
def test_each_torque_acts_from_half_a_period_after_its_call_to_half_a_period_after_the_next(script):
    late, found = script.HalfLate(Counting()), []
    for _ in range(7):
        torque, _ = late.predict(np.zeros((1, 10)), None, np.ones(1, dtype=bool))
        found.append(torque[0, 0])
    assert found == [1.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0]
