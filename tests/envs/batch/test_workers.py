"""Threads that share a step, and the memory of its results."""

import copy
import pickle
import threading

import gymnasium as gym
import numba
import numpy as np
import pytest
from support.randomisation import ROBUST

from fuzzyarm.envs.batch import board as boards
from fuzzyarm.envs.batch.results_memory import ResultsMemory
from fuzzyarm.envs.batch.workers import Workers
from fuzzyarm.envs.physics.records import BLOCK

take, finish, wait = (numba.njit(nogil=True)(part) for part in (boards.take, boards.finish, boards.wait))


def advance_noting(seen):
    """A kernel's stand-in that does no physics: it notes who took which piece."""

    def advance(board, period, substeps, looks):
        while (piece := take(board, max(looks, 1))) >= 0:
            seen.append((threading.current_thread(), piece))
            finish(board)
        if looks == 0:
            wait(board)

    return advance


def arrays_of(lanes):
    return np.zeros((1, 1, 1)), np.zeros((1, lanes), dtype=np.int64), np.zeros((1, 1)), 1e-3, 1


@pytest.mark.parametrize(("lanes", "threads"), [(1, 1), (BLOCK, 2), (1000, 2), (40 * BLOCK + 1, 3)])
def test_every_lane_is_in_one_piece_and_pieces_are_whole_blocks(lanes, threads):
    workers, seen = Workers(lanes, threads), []
    for _ in range(3):
        seen.clear()
        assert workers.step(advance_noting(seen), arrays_of(lanes), np.zeros((lanes, 2)), np.empty(1)) == -1
        size = int(workers._board[boards.AT.size])
        assert sorted(piece for _, piece in seen) == list(range(-(-lanes // size)))
        assert size % BLOCK == 0
    workers.close()


def test_the_calling_thread_does_all_where_no_other_comes():
    workers, release, seen = Workers(64 * BLOCK, 2), threading.Event(), []
    step = workers.step, arrays_of(64 * BLOCK), np.zeros((64 * BLOCK, 2)), np.empty(1)

    def busy(board, period, substeps, looks):
        """Do the step in the calling thread alone; the other one is busy with something else."""
        release.wait() if looks else advance_noting(seen)(board, period, substeps, 0)

    for _ in range(2):
        seen.clear()
        step[0](busy, *step[1:])
        assert len(seen) == 16 and {thread for thread, _ in seen} == {threading.current_thread()}
    release.set()
    workers.close()


def test_torques_that_are_not_finite_are_not_posted():
    workers, action, seen = Workers(8 * BLOCK, 2), np.zeros((8 * BLOCK, 2)), []
    action[5, 1] = np.nan
    assert workers.step(advance_noting(seen), arrays_of(8 * BLOCK), action, np.empty(1)) == 5
    assert not seen


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda workers: pickle.loads(pickle.dumps(workers))])
def test_a_copy_has_a_board_of_its_own(copied):
    workers, seen = Workers(8 * BLOCK, 2), []
    for each in (workers, copied(workers)):
        seen.clear()
        each.step(advance_noting(seen), arrays_of(8 * BLOCK), np.zeros((8 * BLOCK, 2)), np.empty(1))
        assert sorted(piece for _, piece in seen) == list(range(4))
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
