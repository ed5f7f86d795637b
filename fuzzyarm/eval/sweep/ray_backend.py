"""A joblib backend over Ray tasks.

Ray's own (`ray.util.joblib`) is a pool of actors: it hands results over all at once at the end, and when a worker
process dies the rest of its share fails too. A task is one piece of work with a process of its own: when that dies,
only this piece is run again, while the others go on.
"""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import ray
from joblib import register_parallel_backend
from joblib._parallel_backends import ParallelBackendBase
from ray.exceptions import LocalRayletDiedError, NodeDiedError, OutOfMemoryError, WorkerCrashedError

from fuzzyarm.eval.sweep.engine import TRIES, WorkersLost

NAME = "fuzzyarm-ray"
LOST = (LocalRayletDiedError, NodeDiedError, OutOfMemoryError, WorkerCrashedError)


class RayTasks(ParallelBackendBase):
    """Joblib's side of it: every submitted piece of work is a Ray task."""

    supports_retrieve_callback = True
    default_n_jobs = -1

    def __init__(self, report: Callable[[str], None] = lambda _: None, **arguments: Any) -> None:
        """Keep what is told of a lost worker."""
        super().__init__(**arguments)
        self._report, self._tasks = report, set[Any]()

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Return how many workers there are: all CPUs of the cluster, or `n_jobs` if that is fewer."""
        cpus = max(1, int(ray.cluster_resources().get("CPU", 1)))
        return cpus if n_jobs < 0 else min(n_jobs, cpus)

    def submit(self, func: Callable[[], Any], callback: Callable[[Any], None] | None = None) -> None:
        """Start a task; `callback` gets the future of the try that decides."""
        self._start(func, callback or (lambda _: None), TRIES)

    def retrieve_result_callback(self, out: Future[Any]) -> Any:
        """Return what a task returned, or raise what it raised."""
        try:
            return out.result()
        except LOST as error:
            raise WorkersLost(f"workers died {TRIES} times at the same chunk ({type(error).__name__})") from None

    def abort_everything(self, ensure_ready: bool = True) -> None:
        """Cancel all tasks."""
        for task in list(self._tasks):
            ray.cancel(task, force=True)
        self._tasks.clear()

    def terminate(self) -> None:
        """Cancel what is left."""
        self.abort_everything()

    def _start(self, func: Callable[[], Any], callback: Callable[[Any], None], tries: int) -> None:
        task = _call.remote(func)
        self._tasks.add(task)

        def done(future: Future[Any]) -> None:
            wanted = task in self._tasks
            self._tasks.discard(task)
            if wanted and tries > 1 and isinstance(future.exception(), LOST):
                self._report("a worker died; the chunk it was at is run again")
                self._start(func, callback, tries - 1)
            else:
                callback(future)

        task.future().add_done_callback(done)


@contextlib.contextmanager
def cluster(address: str | None, jobs: int | None) -> Iterator[None]:
    """Connect to a cluster, or start one on this machine with `jobs` workers; one that is connected already stays.

    Raises:
        ValueError: no cluster answers at the address.
    """
    if ray.is_initialized():
        yield
        return
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
    # What Ray has to say of a lost worker it prints to standard output, which is for results.
    with contextlib.redirect_stdout(sys.stderr):
        if address is None:
            ray.init(num_cpus=jobs, include_dashboard=False, **quiet)
        else:
            _reach(address)
            try:
                ray.init(address=address, **quiet)
            except (ConnectionError, RuntimeError, ValueError) as error:
                raise ValueError(
                    f"no Ray cluster at {address!r}: {str(error).splitlines()[0]}; if it has a token, "
                    "set RAY_AUTH_MODE=token"
                ) from None
        try:
            yield
        finally:
            ray.shutdown()


def _reach(address: str) -> None:
    """See that something answers at HOST:PORT: Ray itself would try for minutes, and then exit."""
    host, _, port = address.rpartition(":")
    if not port.isdigit():
        return
    try:
        socket.create_connection((host, int(port)), timeout=10.0).close()
    except OSError as error:
        raise ValueError(f"no Ray cluster at {address!r}: {error.strerror or error}") from None


@ray.remote(max_retries=0, num_cpus=1)  # what is lost is run again by `_start`, which says so
def _call(func: Callable[[], Any]) -> Any:
    return func()


register_parallel_backend(NAME, RayTasks)
