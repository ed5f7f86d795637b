"""Machine code from disk: what was compiled in different processes does not get into each other's way."""

import json
import os
import subprocess
import sys

import pytest

NUMBER = """
from numba.core.bytecode import FunctionIdentity
import fuzzyarm.envs.physics.compiled
print(next(FunctionIdentity._unique_ids))
"""

EPISODES = """
import json, sys
import gymnasium as gym
from fuzzyarm import load_policy
found = {}
for name in sys.argv[1:]:
    policy, state = load_policy("computed-torque", robot=name), None
    env = gym.make("fuzzyarm:FuzzyArm-v0", robot=name)
    observation, _ = env.reset(seed=0)
    for _ in range(200):
        action, state = policy.predict(observation, state)
        observation, _, _, _, info = env.step(action)
    found[name] = observation.tolist()
print(json.dumps(found))
"""


def printed(script, *arguments, **environment):
    run = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, check=True, env=os.environ | environment
    )
    return json.loads(run.stdout)


def test_functions_of_two_processes_have_different_numbers():
    assert abs(printed(NUMBER) - printed(NUMBER)) > 10**6


@pytest.mark.slow
def test_two_robots_compiled_in_processes_of_their_own_act_together_as_alone(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    alone = printed(EPISODES, "planar-3r", **cache) | printed(EPISODES, "ur5", **cache)
    assert printed(EPISODES, "planar-3r", "ur5", **cache) == alone
