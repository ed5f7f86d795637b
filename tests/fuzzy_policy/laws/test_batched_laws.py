"""Model-based policies on the batched environment: one call evaluates a thousand independent controllers."""

import gymnasium as gym
import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import load_policy

LANES = 1024


@pytest.mark.parametrize("name", slow_but(["fuzzy-4"], ["fuzzy-4", "fuzzy-32", "computed-torque"]))
def test_a_thousand_different_arms_are_tracked_to_the_end(name):
    policy, envs = (
        load_policy(name, allow_unproven=True),
        gym.make_vec("FuzzyArm-v0", num_envs=LANES, randomisation="plants"),
    )
    observation, info = envs.reset(seed=0)
    assert len(np.unique(info["randomisation"]["mass"], axis=0)) == LANES
    state, worst, halfway = None, np.zeros(LANES), None
    for step in range(1, 1501):
        action, state = policy.predict(observation, state=state)
        observation, _, terminated, truncated, info = envs.step(action)
        assert action.shape == state.shape == (LANES, 2) and not terminated.any()
        assert truncated.all() if step == 1500 else not truncated.any()
        worst = np.maximum(worst, (info["final_info"] if step == 1500 else info)["tip_error"])
        halfway = state if step == 750 else halfway
    assert worst.min() > 1e-3 and worst.max() < 6e-3  # Table 1 itself: 4.2 to 4.6 mm
    assert len(np.unique(halfway, axis=0)) == LANES  # an integral of its own for each
