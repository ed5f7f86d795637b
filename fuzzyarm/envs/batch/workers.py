"""The threads that share a step; compiled code runs in them side by side."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from fuzzyarm.envs.physics.records import BLOCK

__all__ = ["LANES_PER_THREAD", "Workers"]

LANES_PER_THREAD = 1024  # from about here on a thread is worth the handing over


class Workers:
    """Threads that are started when they are needed, and left behind by copies and pickles.

    Args:
        count: number of lanes.
        threads: how many may share a step; None: one per 1024 lanes, at most one per core.
    """

    def __init__(self, count: int, threads: int | None) -> None:
        """Divide the lanes into one range per thread."""
        self.threads = threads or max(1, min(_cores(), count // LANES_PER_THREAD))
        share = -(-count // (self.threads * BLOCK)) * BLOCK  # whole blocks to each thread
        self._ranges = [(start, min(start + share, count)) for start in range(0, count, share)]
        self._pool: ThreadPoolExecutor | None = None
        self._owner = 0

    def run(self, work: Callable[[int, int], int]) -> list[int]:
        """Return what work(start, stop) returns for each range of lanes."""
        # Threads do not survive a fork: a forked process starts its own.
        if self._pool is None or self._owner != os.getpid():
            self._pool, self._owner = ThreadPoolExecutor(self.threads), os.getpid()
        parts = [self._pool.submit(work, start, stop) for start, stop in self._ranges]
        return [part.result() for part in parts]

    def close(self) -> None:
        """End the threads; a later `run` starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, object]:
        """Leave the threads behind."""
        return {**self.__dict__, "_pool": None}


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
