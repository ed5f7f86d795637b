"""Machine code from disk: what was compiled in different processes does not get into each other's way."""

import json
import os
import subprocess
import sys

import pytest
from numba import config
from numba.core.bytecode import FunctionIdentity
from numba.core.codegen import get_host_cpu_features

from fuzzyarm.envs.physics import compiled

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
    assert abs(printed(NUMBER) - next(FunctionIdentity._unique_ids)) > 10**6


@pytest.mark.slow
def test_two_robots_compiled_in_processes_of_their_own_act_together_as_alone(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    alone = printed(EPISODES, "planar-3r", **cache) | printed(EPISODES, "ur5", **cache)
    assert printed(EPISODES, "planar-3r", "ur5", **cache) == alone


BATCH = """
import json
import gymnasium as gym
import numpy as np
env = gym.make_vec("fuzzyarm:FuzzyArm-v0", num_envs=19, case="machining", randomisation="robust", robot="planar-3r")
env.reset(seed=1)
generator = np.random.default_rng(0)
for _ in range(50):
    observation, *_ = env.step(generator.uniform(-20.0, 20.0, (19, 3)))
print(json.dumps(observation.tolist()))
"""


def test_vectors_are_as_wide_as_the_processor_has_them_unless_a_user_says_otherwise(monkeypatch):
    for own, expected in ((None, "+avx512f,-prefer-256-bit"), ("+avx2", "+avx2")):
        monkeypatch.setattr(compiled, "get_host_cpu_features", lambda: "+avx512f")
        monkeypatch.setattr(config, "CPU_NAME", None)
        monkeypatch.setattr(config, "CPU_FEATURES", own)
        compiled._use_whole_vectors()
        assert expected == config.CPU_FEATURES
    monkeypatch.setattr(compiled, "get_host_cpu_features", lambda: "+neon")
    monkeypatch.setattr(config, "CPU_FEATURES", None)
    compiled._use_whole_vectors()
    assert config.CPU_FEATURES is None


@pytest.mark.slow
def test_wide_vectors_round_no_differently(tmp_path):
    narrow = {"NUMBA_CPU_FEATURES": get_host_cpu_features(), "NUMBA_CACHE_DIR": str(tmp_path)}
    assert printed(BATCH, **narrow) == printed(BATCH)
