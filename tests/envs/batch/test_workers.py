"""Threads that share a step, and the memory of its results."""

import threading
import time

import numpy as np
import pytest

from fuzzyarm.envs.batch.results_memory import ResultsMemory
from fuzzyarm.envs.batch.workers import Workers
from fuzzyarm.envs.physics.records import BLOCK


@pytest.mark.parametrize(("lanes", "threads"), [(1, 1), (BLOCK, 2), (1000, 2), (40 * BLOCK + 1, 3)])
def test_every_lane_is_in_one_piece_and_pieces_are_whole_blocks(lanes, threads):
    workers, done = Workers(lanes, threads), np.zeros(lanes, dtype=int)
    begins = []

    def work(start, stop):
        begins.append(start)
        done[start:stop] += 1

    if threads > 1:
        workers.run(work)
        assert np.all(done == 1) and all(start % BLOCK == 0 for start in begins)
    workers.close()


def test_the_calling_thread_does_all_where_no_other_comes():
    workers, release, caller = Workers(64 * BLOCK, 2), threading.Event(), []
    workers.run(lambda start, stop: None)  # starts the other thread
    workers._helpers._tasks.put(release.wait)  # it is busy with something else
    while not workers._helpers._tasks.empty():
        time.sleep(1e-3)
    workers.run(lambda start, stop: caller.append(threading.current_thread()))
    assert len(caller) == 16 and set(caller) == {threading.current_thread()}
    release.set()
    workers.close()


def test_an_error_in_a_piece_reaches_the_caller():
    workers = Workers(8 * BLOCK, 2)
    with pytest.raises(ZeroDivisionError):
        workers.run(lambda start, stop: 1 // (start - start))
    workers.close()


def test_memory_is_used_again_only_where_no_view_is_left():
    memory = ResultsMemory(10)
    first = memory.array()
    first[:] = 1.0
    view = first[2:].reshape(2, 4)
    place = first.ctypes.data
    del first
    second = memory.array()
    second[:] = 2.0
    assert second.ctypes.data != place and np.all(view == 1.0)
    del view
    assert memory.array().ctypes.data == place
