"""The threads that share a step; they meet in compiled code, see `board`."""

from __future__ import annotations

import math
import os
import threading
import time
import weakref
from queue import SimpleQueue
from typing import Any, TypeAlias

import numpy as np

from fuzzyarm.envs.batch.board import AT, BOARD, post
from fuzzyarm.envs.physics.records import BLOCK

__all__ = ["LANES_PER_THREAD", "Workers"]

LANES_PER_THREAD = 256  # from about here on a thread is worth the handing over to one that is awake
_WORTH_WAKING = 2048  # lanes for each thread, from which on a thread is worth waking for one step
_PIECES = 8  # for each thread: the last one to finish keeps the others waiting for one piece at most
_SMALLEST = 2 * BLOCK  # lanes of a piece
_LOOKS = 500_000  # at the board before a thread goes to sleep, some tenths of a millisecond
_SOON = 2e-4  # s; a step that comes so soon after the last one will have others soon after it

Task: TypeAlias = tuple[Any, float, int] | None
"""What a thread does when it is woken: `Kernels.advance`, control period [s], sub-steps. None: it ends."""


class Workers:
    """Threads that are started when they are needed, and left behind by copies and pickles.

    The thread that calls takes part: it does all that the others do not come to, and never waits for one that has not
    begun. So a step is no slower than with one thread where a machine has no second core to spare. After a step the
    others look out for the next one for a moment before they sleep. To wake them takes as long as to step some hundred
    lanes: a small batch does it only where steps follow each other at once.

    Args:
        count: number of lanes.
        threads: how many may share a step; None: one per 256 lanes, at most one per core.
    """

    def __init__(self, count: int, threads: int | None) -> None:
        """Divide the lanes into pieces of whole blocks."""
        self.threads = threads or _most(count // LANES_PER_THREAD)
        share, piece = (-(-count // (parts * BLOCK)) * BLOCK for parts in (self.threads, _PIECES * self.threads))
        size = share if self.threads == 1 else max(min(_SMALLEST, share), piece)
        self._worth_waking = count >= _WORTH_WAKING * self.threads
        self._division = {"pieces": -(-count // size), "size": size, "lanes": count}
        self._begin()

    def _begin(self) -> None:
        self._helpers: _Helpers | None = None
        self._last = -math.inf  # s, when the last step ended
        self._lock = threading.Lock()  # the board holds one step
        self._board = np.zeros(BOARD, dtype=np.int64)
        for name, number in self._division.items():
            self._board[getattr(AT, name)] = number
        self._board[AT.next] = self._division["pieces"]  # nothing is posted yet

    def step(self, advance: Any, arrays: tuple[Any, ...], action: np.ndarray, out: np.ndarray) -> int:
        """Hold torques in all lanes for one control step.

        Args:
            advance: `Kernels.advance` for these lanes.
            arrays: `Lanes.arrays`.
            action: (lanes, joints) motor torques [N m].
            out: the results of all lanes; written.

        Returns:
            -1; or the first lane whose torques are not all finite, and no lane has moved.
        """
        *state, period, substeps = arrays
        with self._lock:
            bad: int = post(self._board, *state, action, out)
            if bad < 0:
                if self.threads > 1 and (self._worth_waking or time.perf_counter() < self._last + _SOON):
                    self._wake((advance, period, substeps))
                advance(self._board, period, substeps, 0)
                self._last = time.perf_counter()
        return bad

    def close(self) -> None:
        """End the threads; a later step starts new ones."""
        if self._helpers is not None:
            self._helpers.close()
            self._helpers = None

    def _wake(self, task: Task) -> None:
        # Threads do not survive a fork: a forked process starts its own.
        if self._helpers is None or self._helpers.owner != os.getpid():
            self._helpers = _Helpers(self.threads - 1, self._board)
        self._helpers.wake(task)

    def __getstate__(self) -> dict[str, object]:
        """Leave the threads behind."""
        return {name: self.__dict__[name] for name in ("threads", "_worth_waking", "_division")}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Begin with a board of its own."""
        self.__dict__.update(state)
        self._begin()


class _Helpers:
    """Threads beside the one that calls.

    Attributes:
        owner: the process that they live in.
    """

    def __init__(self, count: int, board: np.ndarray) -> None:
        """Start them; they sleep."""
        self.owner = os.getpid()
        self._tasks: SimpleQueue[Task] = SimpleQueue()
        self._asleep = [True] * count
        # They know no more than this, so that they end with this object where nobody closes it.
        self._threads = [
            threading.Thread(target=_serve, args=(board, self._tasks, self._asleep), daemon=True) for _ in range(count)
        ]
        for thread in self._threads:
            thread.start()
        self._finish = weakref.finalize(self, _dismiss, self._tasks, count)

    def wake(self, task: Task) -> None:
        """Let those that sleep do the task."""
        while self._asleep:
            self._asleep.pop()
            self._tasks.put(task)

    def close(self) -> None:
        """End the threads."""
        self._finish()
        for thread in self._threads:
            thread.join()


def _serve(board: np.ndarray, tasks: SimpleQueue[Task], asleep: list[bool]) -> None:
    """Do what is posted on a board whenever there is a task, until one is None."""
    while (task := tasks.get()) is not None:
        advance, period, substeps = task
        advance(board, period, substeps, _LOOKS)
        asleep.append(True)


def _dismiss(tasks: SimpleQueue[Task], count: int) -> None:
    """Let so many threads end."""
    for _ in range(count):
        tasks.put(None)


def _most(wanted: int) -> int:
    """Return so many threads, but at most one per core that this process may use, a container's quota included."""
    if wanted <= 1:
        return 1
    from joblib import cpu_count  # here, as a single arm and a small batch need it not

    return min(wanted, int(cpu_count()))
