"""Model-based policies on the batched environment: one call evaluates a thousand independent controllers."""

import gymnasium as gym
import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.policies import NAMES

LANES = 1024
HERE = slow_but(["fuzzy-4", "computed-torque"], NAMES)  # test_laws asks much the same of every policy
NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-5, velocity=1e-3))


def load(name):
    """A policy without the proof that loading it repeats; that has its own tests."""
    return load_policy(name, allow_unproven=True)


@pytest.mark.parametrize("name", slow_but(["fuzzy-4"], ["fuzzy-4", "fuzzy-32", "computed-torque"]))
def test_a_thousand_different_arms_are_tracked_to_the_end(name):
    policy, envs = load(name), gym.make_vec("FuzzyArm-v0", num_envs=LANES, randomisation="plants")
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


@pytest.mark.parametrize("name", HERE)
def test_controllers_begin_anew_with_the_episodes_of_their_lanes(name):
    """Closed loops through resets of their own, against single environments and controllers."""
    references = [JointReference(path=Line((0.4, 0.5), (0.42, 0.5)), duration=0.02 * k) for k in (2, 3, 5, 2)]
    arguments = {"disturbance": NOISY, "randomisation": "plants"}
    policy, lanes, steps = load(name), len(references), 130
    envs = gym.make_vec("FuzzyArm-v0", num_envs=lanes, reference=references, **arguments)
    observation, _ = envs.reset(seed=0)
    state, starts, shown = None, None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state=state, episode_start=starts)
        observation, _, terminated, truncated, _ = envs.step(action)
        starts = terminated | truncated
        shown.append((action, state))
    for lane, reference in enumerate(references):
        env, episodes = gym.make("FuzzyArm-v0", reference=reference, **arguments), 0
        (single, _), memory = env.reset(seed=lane), None
        for action, state in shown:
            torque, memory = policy.predict(single, state=memory)
            assert torque.tobytes() == action[lane].tobytes() and memory.tobytes() == state[lane].tobytes()
            single, _, terminated, truncated, _ = env.step(torque)
            if terminated or truncated:
                (single, _), memory, episodes = env.reset(), None, episodes + 1
        assert episodes == steps // round(1000 * reference.duration)
