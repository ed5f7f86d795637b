"""Threads that share a step, and the memory of its results."""

import copy
import pickle
import threading

import gymnasium as gym
import numpy as np
import pytest

from fuzzyarm.envs.batch.layout import ResultsMemory
from fuzzyarm.envs.batch.workers import LANES_PER_THREAD, Workers
from fuzzyarm.numbers.machine import WIDE


class Noting:
    """A kernel's stand-in that does nothing: it notes who took which lanes."""

    def __init__(self, lanes):
        self.lanes, self.seen, self.may_go = lanes, [], threading.Event()
        self.may_go.set()

    def __call__(self):
        self.part(0, self.lanes)

    def part(self, first, stop):
        if threading.current_thread() is not threading.main_thread():
            self.may_go.wait(60)
        self.seen.append((threading.current_thread(), first, stop))


@pytest.mark.parametrize(("lanes", "threads"), [(1, 1), (1000, 2), (40 * LANES_PER_THREAD + 1, 3)])
def test_every_lane_is_in_one_piece_and_pieces_are_whole_blocks(lanes, threads):
    workers = Workers(lanes, threads)
    workers.run(Noting(lanes))
    for one in (workers, copy.deepcopy(workers), pickle.loads(pickle.dumps(workers))):
        assert one is workers or one._pool is None  # a copy has threads of its own
        call = Noting(lanes)
        one.run(call)
        pieces = sorted((first, stop) for _, first, stop in call.seen)
        assert [first for first, _ in pieces] == [0, *(stop for _, stop in pieces[:-1])] and pieces[-1][1] == lanes
        assert all(first % WIDE == 0 for first, _ in pieces)
        one.close()


def test_the_calling_thread_does_all_where_no_other_comes():
    """The pool's only thread is busy with something else; the step neither waits for it nor is done twice."""
    workers, call = Workers(64 * LANES_PER_THREAD, 2), Noting(64 * LANES_PER_THREAD)
    workers.run(call)
    released = threading.Event()
    workers._pool.submit(released.wait, 60)
    call.seen.clear()
    workers.run(call)
    assert {thread for thread, _, _ in call.seen} == {threading.current_thread()}
    assert sum(stop - first for _, first, stop in call.seen) == 64 * LANES_PER_THREAD
    released.set()
    workers.close()


def test_memory_is_used_again_only_where_no_view_is_left():
    memory = ResultsMemory(10)
    room = memory.room()
    first = room.array()
    first[:] = 1.0
    view = first[2:].reshape(2, 4)
    assert first.ctypes.data % 64 == 0
    del first
    second = memory.room()
    second.array()[:] = 2.0
    assert second is not room and np.all(view == 1.0)
    del view
    assert memory.room() is room


def test_memory_of_results_that_nobody_holds_serves_again():
    envs, twin = (gym.make_vec("fuzzyarm:FuzzyArm-v0", num_envs=40) for _ in range(2))
    torques = np.random.default_rng(0).uniform(-20.0, 20.0, (12, 40, 2))
    for one in (envs, twin):
        one.reset(seed=0)
    held = [envs.step(torque)[0] for torque in torques]
    copies, places = [], set()
    for torque in torques:
        observation = twin.step(torque)[0]
        places.add(observation.ctypes.data)
        copies.append(observation.copy())
    assert np.array_equal(held, copies) and len({row.ctypes.data for row in held}) == len(held)
    assert len(places) <= 3
