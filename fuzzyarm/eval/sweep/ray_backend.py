"""A joblib backend over Ray tasks.

Ray's own backend (`ray.util.joblib`) is a pool of actors. It returns all results at once at the end, and when a worker
process dies, the rest of that worker's share fails too. Here each piece of work is a task with a process of its own:
when the process dies, only this piece is run again, while the others continue.
"""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import ray
from joblib import register_parallel_backend
from joblib._parallel_backends import ParallelBackendBase
from ray.exceptions import (
    LocalRayletDiedError,
    NodeDiedError,
    OutOfMemoryError,
    RayTaskError,
    RuntimeEnvSetupError,
    WorkerCrashedError,
)

from fuzzyarm.eval.sweep.losses import TRIES, WorkersLost

__all__ = ["NAME", "RayTasks", "cluster"]

NAME = "fuzzyarm-ray"
"""What joblib knows the backend by."""
_LOST = (LocalRayletDiedError, NodeDiedError, OutOfMemoryError, WorkerCrashedError)


class RayTasks(ParallelBackendBase):
    """The joblib backend: every submitted piece of work is a Ray task."""

    supports_retrieve_callback = True
    default_n_jobs = -1

    def __init__(self, report: Callable[[str], None] = lambda _: None, **arguments: Any) -> None:
        """Keep the function that is called with a line when a worker is lost."""
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
        except _LOST as error:
            raise WorkersLost(f"workers died {TRIES} times at the same chunk ({type(error).__name__})") from None
        except RayTaskError as error:
            raise error.cause from None  # the error itself; Ray's own message is a traceback of many lines
        except RuntimeEnvSetupError as error:
            raise ValueError(f"Ray cannot send the policies' modules: {str(error).splitlines()[0]}") from None

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
            if wanted and tries > 1 and isinstance(future.exception(), _LOST):
                self._report("a worker died; the chunk it was at is run again")
                self._start(func, callback, tries - 1)
            else:
                callback(future)

        task.future().add_done_callback(done)


@contextlib.contextmanager
def cluster(address: str | None, jobs: int | None, modules: Sequence[Path] = ()) -> Iterator[None]:
    """Connect to a cluster, or start one on this machine, for the duration of the block.

    A cluster that this process is connected to already is used as it is, and stays connected; it must know `modules`.

    Args:
        address: of the cluster; None starts one on this machine.
        jobs: number of workers of the one that is started.
        modules: package folders and module files that Ray sends to the workers.

    Raises:
        ValueError: no cluster answers at the address, or the modules cannot be sent.
    """
    if ray.is_initialized():
        yield
        return
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
    if modules:
        options["runtime_env"] = {"py_modules": [str(module) for module in modules]}
    # Ray prints its messages about lost workers to standard output, which is for results.
    with contextlib.redirect_stdout(sys.stderr):
        if address is None:
            ray.init(num_cpus=jobs, include_dashboard=False, **options)
        else:
            _reach(address)
            try:
                ray.init(address=address, **options)
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
    """Check that something answers at HOST:PORT: Ray itself would try for minutes, and then exit the process."""
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
