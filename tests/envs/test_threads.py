"""An environment is for one thread. Where several use one all the same, results are wrong, but nothing crashes."""

import subprocess
import sys

import pytest

ABUSE = """
import threading, time
import numpy as np
from gymnasium.error import ResetNeeded
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation  # noqa: E402
from fuzzyarm.envs.scenario.reference import JointReference  # noqa: E402
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

short = JointReference(duration=1.0)
references = (short, JointReference())
{make}
env.reset(seed=0)
end = time.monotonic() + 1.0

def use(number):
    generator = np.random.default_rng(number)
    while time.monotonic() < end:
        try:
            if generator.random() < 0.02:
                env.reset(options={{"reference": short}} if generator.random() < 0.5 and own else None)
            for _ in range(200):
                env.step(action)
        except (ResetNeeded, ValueError, IndexError, KeyError):
            pass

threads = [threading.Thread(target=use, args=(number,)) for number in range(4)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
print("survived")
"""
KINDS = {
    "single": "env, action, own = FuzzyArmEnv(control_period=0.02), np.zeros(2), True",
    "family": "env, action, own = FuzzyArmEnv(control_period=0.02, randomisation=DomainRandomisation("
    "references=references)), np.zeros(2), False",
    "batch": "env, action, own = FuzzyArmVectorEnv(3, control_period=0.02), np.zeros((3, 2)), True",
}


BEYOND = """
import numpy as np
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
env = FuzzyArmEnv(control_period=0.1, substep=1e-3)
env.reset(seed=0)
last = 0.0
for _ in range(40_000):
    env._ended = False  # as another thread may find it
    last = env.step(np.zeros(2))[-1]["time"]
print(round(last, 9))
"""


@pytest.mark.slow
def test_a_step_past_the_end_of_the_schedule_stays_at_its_end():
    """What two threads do that both find the episode still running, and go on for ever."""
    done = subprocess.run([sys.executable, "-c", BEYOND], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.returncode
    assert done.stdout == "1.5\n"


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=pytest.mark.slow) for kind in ("single", "family", "batch")])
def test_an_environment_used_by_several_threads_does_not_crash(kind):
    script = ABUSE.format(make=KINDS[kind])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "survived" in done.stdout
