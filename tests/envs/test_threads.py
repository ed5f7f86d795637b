"""An environment is for one thread. Where several use one all the same, results are wrong, but nothing crashes."""

import subprocess
import sys

import pytest

ABUSE = """
import threading, time
import numpy as np
from gymnasium.error import ResetNeeded
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

references = JointReference(duration=1.0), JointReference()
env = {make}
action = np.zeros(env.action_space.shape)
env.reset(seed=0)
end = time.monotonic() + 1.0

def use(number):
    generator = np.random.default_rng(number)
    while time.monotonic() < end:
        try:
            if generator.random() < 0.02:
                env.reset(options={{"reference": references[0]}} if generator.random() < 0.5 else None)
            for _ in range(200):
                env.step(action)
        except (ResetNeeded, ValueError, IndexError, KeyError):
            pass

threads = [threading.Thread(target=use, args=(number,)) for number in range(4)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
env = FuzzyArmEnv(control_period=0.1, substep=1e-3)
env.reset(seed=0)
for _ in range(40_000):
    env._ended = False  # as another thread may find it: the step stays at the end of the schedule
    last = env.step(np.zeros(2))[-1]["time"]
print(round(last, 9))
"""
KINDS = {
    "family": "FuzzyArmEnv(control_period=0.02, randomisation=DomainRandomisation(references=references))",
    "batch": "FuzzyArmVectorEnv(3, control_period=0.02)",
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_an_environment_used_by_several_threads_does_not_crash(kind):
    script = ABUSE.format(make=KINDS[kind])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout == "1.5\n"
