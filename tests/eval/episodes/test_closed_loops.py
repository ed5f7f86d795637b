"""Law and plant in one kernel: the numbers of the ordinary loop, to the last bit."""

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.eval.sweep import episodes
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import run_plants
from fuzzyarm.fuzzy_policy.law import law_of
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy

POLICIES = "fuzzy-4", "fuzzy-1-tip", "computed-torque", "computed-torque-tip", "elastic-observer"


@pytest.mark.slow
@pytest.mark.parametrize("name", POLICIES)
@pytest.mark.parametrize("distribution", ["loads", "all"])
def test_a_kernel_of_law_and_plant_has_the_bits_of_the_loop(name, distribution, monkeypatch):
    # 65 plants in three cases are more than one group of lanes, and no whole number of blocks; some end early.
    config = SweepConfig(policies=(name,), plants=65, distribution=distribution, seed=3)
    ranges = (("payload", 0.0, 60.0),)
    heavy = SweepConfig(policies=(name,), plants=40, distribution=distribution, ranges=ranges, cases=("machining",))
    for one in (config, heavy):
        results = []
        for threshold in (1, 10**9):
            monkeypatch.setattr(episodes, "WORTHWHILE", threshold)
            results.append(run_plants(one, {name: load_policy(name)}, one.members(0)))
        for name, array in results[0].arrays.items():
            assert np.array_equal(array, results[1].arrays[name]), name


def test_a_law_that_a_subclass_changes_is_not_compiled():
    class Gentle(FuzzyPolicy):
        def act(self, observation, memory, torque):
            super().act(observation, memory, torque)
            torque *= 0.5

    policy = load_policy("fuzzy-4")
    assert law_of(policy).memory == (0.0, 0.0)
    assert law_of(Gentle(policy.controller)) is None
    assert law_of(load_policy("ppo-robust")) is not None
