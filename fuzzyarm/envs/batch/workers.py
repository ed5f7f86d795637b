"""The threads that share a step; compiled code runs in them side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

from fuzzyarm.envs.physics.records import BLOCK

__all__ = ["LANES_PER_THREAD", "Workers"]

LANES_PER_THREAD = 512  # from about here on a thread is worth the handing over
_PIECES = 8  # for each thread: the last one to finish keeps the others waiting for one piece at most
_SMALLEST = 4 * BLOCK  # lanes of a piece


class Workers:
    """Threads that are started when they are needed, and left behind by copies and pickles.

    The thread that calls takes part: it does all that the others do not come to, and never waits for one that has not
    begun. So a step is no slower than with one thread where a machine has no second core to spare.

    Args:
        count: number of lanes.
        threads: how many may share a step; None: one per 512 lanes, at most one per core.
    """

    def __init__(self, count: int, threads: int | None) -> None:
        """Divide the lanes into pieces of whole blocks."""
        self.threads = threads or max(1, min(_cores(), count // LANES_PER_THREAD))
        share, piece = (-(-count // (parts * BLOCK)) * BLOCK for parts in (self.threads, _PIECES * self.threads))
        size = max(min(_SMALLEST, share), piece)
        self._pieces = [(start, min(start + size, count)) for start in range(0, count, size)]
        self._pool: ThreadPoolExecutor | None = None
        self._owner = 0

    def run(self, work: Callable[[int, int], None]) -> None:
        """Call work(start, stop) for each piece of the lanes."""
        # Threads do not survive a fork: a forked process starts its own.
        if self._pool is None or self._owner != os.getpid():
            self._pool, self._owner = ThreadPoolExecutor(self.threads - 1), os.getpid()
        pieces = iter(self._pieces)
        helpers = [self._pool.submit(_take, work, pieces) for _ in range(self.threads - 1)]
        _take(work, pieces)
        for helper in helpers:
            if not helper.cancel():
                helper.result()

    def close(self) -> None:
        """End the threads; a later `run` starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, object]:
        """Leave the threads behind."""
        return {**self.__dict__, "_pool": None}


def _take(work: Callable[[int, int], None], pieces: Iterator[tuple[int, int]]) -> None:
    """Do pieces until none is left; `next` of a list's iterator gives each to one thread only."""
    for start, stop in pieces:
        work(start, stop)


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
