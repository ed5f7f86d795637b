"""Messages of the library about slow work; commands show progress with `fuzzyarm.common.console`."""

import contextlib
import functools
import multiprocessing
import sys
import threading
from collections.abc import Iterator

__all__ = ["announced"]


@contextlib.contextmanager
def announced(message: str, after: float = 1.0) -> Iterator[None]:
    """Print `message` on a terminal, once per process, if the block takes longer than `after` [s]."""
    timer = threading.Timer(after, _say_once, (message,))
    timer.daemon = True
    if sys.stderr is not None and sys.stderr.isatty() and multiprocessing.parent_process() is None:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


@functools.cache
def _say_once(message: str) -> None:
    with contextlib.suppress(OSError):
        print(message, file=sys.stderr, flush=True)
