"""The threads that share a step of many lanes."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from fuzzyarm.numbers.machine import WIDE, Call

__all__ = ["LANES_PER_THREAD", "Workers"]

LANES_PER_THREAD = 1024
"""Lanes of the smallest piece, about 100 us of work; waking a thread for less work costs more than it saves."""

_PIECES = 8  # per thread: the others wait for the slowest thread for the duration of one piece at most


class Workers:
    """Threads that are started when they are needed; copies and pickles start their own.

    The calling thread takes part: it does the work that the others have not started, and never waits for a thread that
    has not begun. So a step is no slower than with one thread if no second core is free. By default there is one thread
    per `LANES_PER_THREAD` lanes, at most one per core.
    """

    def __init__(self, count: int, threads: int | None) -> None:
        self.threads = threads or _most(count // LANES_PER_THREAD)
        pieces = 1 if self.threads == 1 else _PIECES * self.threads
        size = max(-(-count // (pieces * WIDE)) * WIDE, LANES_PER_THREAD)
        self._pieces = [(first, min(first + size, count)) for first in range(0, count, size)]
        self._begin()

    def _begin(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._owner = os.getpid()

    def run(self, call: Call) -> None:
        """Run a kernel, bound to its arrays, for all lanes, which are divided among the threads."""
        if self.threads == 1 or len(self._pieces) == 1:
            call()
            return
        if self._pool is None or self._owner != os.getpid():  # threads do not survive a fork
            self._begin()
            self._pool = ThreadPoolExecutor(self.threads - 1)
        left = iter(self._pieces)
        others = [self._pool.submit(_work, call, left) for _ in range(self.threads - 1)]
        _work(call, left)
        for other in others:
            if not other.cancel():
                other.result()

    def close(self) -> None:
        """End the threads; a later step starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, object]:
        return {name: self.__dict__[name] for name in ("threads", "_pieces")}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._begin()


def _work(call: Call, left: Iterator[tuple[int, int]]) -> None:
    """Run a kernel on pieces (first, stop) of the lanes until no piece is left; each thread takes the next piece."""
    for first, stop in left:
        call.part(first, stop)


def _most(wanted: int) -> int:
    """Return the wanted number of threads, at least 1 and at most one per core available to the container."""
    if wanted <= 1:
        return 1
    from joblib import cpu_count  # imported here, because a single arm or a small batch does not need it

    return min(wanted, int(cpu_count()))
