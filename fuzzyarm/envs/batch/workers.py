"""The threads that share a step; compiled code runs in them side by side."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Iterator
from queue import Empty, SimpleQueue
from typing import TypeAlias

from fuzzyarm.envs.physics.records import BLOCK

__all__ = ["LANES_PER_THREAD", "Workers"]

LANES_PER_THREAD = 2048  # from about here on a thread is worth the handing over
_PIECES = 8  # for each thread: the last one to finish keeps the others waiting for one piece at most
_SMALLEST = 4 * BLOCK  # lanes of a piece

Task: TypeAlias = Callable[[], None] | None
"""What a thread does next; None: it ends."""


class Workers:
    """Threads that are started when they are needed, and left behind by copies and pickles.

    The thread that calls takes part: it does all that the others do not come to, and never waits for one that has not
    begun. So a step is no slower than with one thread where a machine has no second core to spare.

    Args:
        count: number of lanes.
        threads: how many may share a step; None: one per 2048 lanes, at most one per core.
    """

    def __init__(self, count: int, threads: int | None) -> None:
        """Divide the lanes into pieces of whole blocks."""
        self.threads = threads or max(1, min(_cores(), count // LANES_PER_THREAD))
        share, piece = (-(-count // (parts * BLOCK)) * BLOCK for parts in (self.threads, _PIECES * self.threads))
        size = max(min(_SMALLEST, share), piece)
        self._pieces = [(start, min(start + size, count)) for start in range(0, count, size)]
        self._helpers: _Helpers | None = None

    def run(self, work: Callable[[int, int], None]) -> None:
        """Call work(start, stop) for each piece of the lanes."""
        # Threads do not survive a fork: a forked process starts its own.
        if self._helpers is None or self._helpers.owner != os.getpid():
            self._helpers = _Helpers(self.threads - 1)
        pieces = iter(self._pieces)
        self._helpers.run(lambda: _take(work, pieces))

    def close(self) -> None:
        """End the threads; a later `run` starts new ones."""
        if self._helpers is not None:
            self._helpers.close()
            self._helpers = None

    def __getstate__(self) -> dict[str, object]:
        """Leave the threads behind."""
        return {**self.__dict__, "_helpers": None}


class _Helpers:
    """Threads beside the one that calls. A pool of `concurrent.futures` takes three times as long to hand work over.

    Attributes:
        owner: the process that they live in.
    """

    def __init__(self, count: int) -> None:
        """Start them."""
        self.owner = os.getpid()
        self._tasks: SimpleQueue[Task] = SimpleQueue()
        self._ends: SimpleQueue[BaseException | None] = SimpleQueue()  # of each task: what it raised
        # They know the queues alone, so that they end with this object where nobody closes it.
        self._threads = [
            threading.Thread(target=_serve, args=(self._tasks, self._ends), daemon=True) for _ in range(count)
        ]
        for thread in self._threads:
            thread.start()
        self._finish = weakref.finalize(self, _dismiss, self._tasks, count)

    def run(self, task: Callable[[], None]) -> None:
        """Do the task here and in every other thread that comes to it before it is done here."""
        for _ in self._threads:
            self._tasks.put(task)
        try:
            task()
        finally:
            raised = [self._end() for _ in self._threads]
        for error in raised:
            if error is not None:
                raise error

    def close(self) -> None:
        """End the threads."""
        self._finish()
        for thread in self._threads:
            thread.join()

    def _end(self) -> BaseException | None:
        """Take back a task that no thread has begun, or wait for the end of one."""
        try:
            self._tasks.get_nowait()
        except Empty:
            return self._ends.get()
        return None


def _serve(tasks: SimpleQueue[Task], ends: SimpleQueue[BaseException | None]) -> None:
    """Do tasks until one is None."""
    while (task := tasks.get()) is not None:
        try:
            task()
        except BaseException as error:  # the thread that called raises it
            ends.put(error)
        else:
            ends.put(None)
        del task  # it holds the arrays of the step


def _dismiss(tasks: SimpleQueue[Task], count: int) -> None:
    """Let so many threads end."""
    for _ in range(count):
        tasks.put(None)


def _take(work: Callable[[int, int], None], pieces: Iterator[tuple[int, int]]) -> None:
    """Do pieces until none is left; `next` of a list's iterator gives each to one thread only."""
    for start, stop in pieces:
        work(start, stop)


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
