"""Threads that share a step, and the memory of its results."""

import subprocess
import sys
import threading

import gymnasium as gym
import numpy as np
import pytest
from support.batches import batch, torques

from fuzzyarm.envs.batch.workers import LANES_PER_THREAD


def test_a_step_does_not_wait_for_a_thread_that_is_busy():
    """The pool's only thread never comes: the calling thread does everything, once."""
    envs, alone = (batch(3 * LANES_PER_THREAD, threads=threads) for threads in (2, 1))
    first, second = torques(0, 2, envs.num_envs)
    for one in (envs, alone):
        one.reset(seed=0)
        one.step(first)
    released = threading.Event()
    busy = envs.lanes._workers._pool.submit(released.wait, 20)
    expected = alone.step(second)[0]
    try:
        assert np.array_equal(envs.step(second)[0], expected) and not busy.done()
    finally:
        released.set()
        envs.close()


def test_memory_of_results_that_nobody_holds_serves_again():
    envs, twin = (gym.make_vec("fuzzyarm:FuzzyArm-v0", num_envs=40) for _ in range(2))
    for one in (envs, twin):
        one.reset(seed=0)
    actions = torques(1, 12, 40)
    held = [envs.step(action)[0] for action in actions]
    copies, places = [], set()
    for action in actions:
        observation = twin.step(action)[0]
        view = observation[2:].reshape(-1)  # keeps the memory as the array itself does
        del observation
        places.add(view.ctypes.data)
        copies.append(view.copy())
    assert np.array_equal([row[2:].reshape(-1) for row in held], copies)
    assert len({row.ctypes.data for row in held}) == len(held) and len(places) <= 3


SEVERAL = """
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
    """It is for one thread: with several, results are wrong."""
    script = SEVERAL.format(make=KINDS[kind])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout == "1.5\n"
