"""Threads that share a step, and the memory of its results."""

import copy
import pickle
import threading

import gymnasium as gym
import numpy as np
import pytest
from support.randomisation import ROBUST

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


@pytest.mark.parametrize(("lanes", "threads"), [(1, 1), (WIDE, 2), (1000, 2), (40 * LANES_PER_THREAD + 1, 3)])
def test_every_lane_is_in_one_piece_and_pieces_are_whole_blocks(lanes, threads):
    workers = Workers(lanes, threads)
    for _ in range(3):
        call = Noting(lanes)
        workers.run(call)
        pieces = sorted((first, stop) for _, first, stop in call.seen)
        assert [first for first, _ in pieces] == [0, *(stop for _, stop in pieces[:-1])] and pieces[-1][1] == lanes
        assert all(first % WIDE == 0 for first, _ in pieces)
    workers.close()


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


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda workers: pickle.loads(pickle.dumps(workers))])
def test_a_copy_has_threads_of_its_own(copied):
    workers = Workers(8 * LANES_PER_THREAD, 2)
    workers.run(Noting(8 * LANES_PER_THREAD))
    twin = copied(workers)
    assert twin._pool is None and workers._pool is not None
    for each in (workers, twin):
        call = Noting(8 * LANES_PER_THREAD)
        each.run(call)
        assert sum(stop - first for _, first, stop in call.seen) == 8 * LANES_PER_THREAD
        each.close()


@pytest.mark.parametrize("order", ["C", "F"])
def test_threads_change_no_bit_of_step_after_step(order):
    torque = np.linspace(-40.0, 40.0, 2 * 700).reshape(700, 2)
    found = []
    for threads in (1, 3):
        envs = gym.make_vec("fuzzyarm:FuzzyArm-v0", num_envs=700, threads=threads, randomisation=ROBUST)
        envs.reset(seed=3)
        steps = [np.array(torque * np.cos(k), order=order if threads > 1 else "C") for k in range(100)]
        found.append(np.stack([envs.step(step)[0] for step in steps]))
        envs.close()
    assert np.array_equal(*found)


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


def test_results_keep_their_values_and_their_memory_serves_again():
    """Whether or not the caller holds them, and after the state of the lanes was restored."""
    envs, twin = (gym.make_vec("fuzzyarm:FuzzyArm-v0", num_envs=40) for _ in range(2))
    rng = np.random.default_rng(0)
    first, _ = envs.reset(seed=0)
    state, torques = envs.unwrapped.get_state(), rng.uniform(-20.0, 20.0, (12, 40, 2))
    assert np.array_equal(twin.reset(seed=0)[0], first)
    held = [envs.step(torque)[0] for torque in torques]
    copies = [twin.step(torque)[0].copy() for torque in torques]
    assert np.array_equal(held, copies)
    assert len({row.ctypes.data for row in held}) == len(held)
    places = set()
    for torque in torques:
        places.add(twin.step(torque)[0].ctypes.data)
    assert len(places) <= 3
    for one in (envs, twin):
        one.unwrapped.set_state(state)
        assert np.array_equal([one.step(torque)[0].copy() for torque in torques], copies)
