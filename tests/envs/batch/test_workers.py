"""Threads that share a step, and the memory of its results."""

import threading

import gymnasium as gym
import numpy as np
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
