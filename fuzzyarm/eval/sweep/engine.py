"""Pieces of work on many workers: joblib, over processes of this machine or over the tasks of a Ray cluster.

A worker that dies, out of memory for example, loses only the pieces that it was running: they are run again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import pickle
import sys
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any, TypeVar

from fuzzyarm.common.checks import choice, whole
from fuzzyarm.common.registry import additions, adopt
from fuzzyarm.eval.sweep.losses import TRIES, WorkersLost
from fuzzyarm.eval.sweep.user_modules import module_sources

__all__ = ["BACKENDS", "Engine", "Report"]

Result = TypeVar("Result")
Report = Callable[[str], None]
"""Takes a line about something that went wrong and was put right."""
BACKENDS = ("local", "ray")
"""Where work can be done: processes of this machine, or tasks of Ray."""


@dataclasses.dataclass(frozen=True)
class Engine:
    """Where the work is done.

    Attributes:
        backend: local (processes of this machine) or ray.
        jobs: number of workers (default: one per core, or all CPUs of the cluster); 1 runs everything in this process.
        address: address of a Ray cluster: auto on one of its machines, or HOST:PORT (default: Ray is started on this
            machine).

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is unknown, out of range or has no effect.
    """

    backend: str = "local"
    jobs: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        choice("backend", self.backend, BACKENDS)
        if self.jobs is not None:
            whole("jobs", self.jobs, low=1)
        if self.address is not None and self.backend != "ray":
            raise ValueError(f"address {self.address!r} is of a Ray cluster: use it with --backend ray")
        if self.address is not None and self.address.startswith("ray://"):
            raise ValueError(
                f"address {self.address!r}: a Ray client cannot do this; run on one of the cluster's machines, "
                "with --address auto or HOST:PORT"
            )

    def run(
        self,
        work: Callable[[int], Result],
        numbers: Sequence[int],
        report: Report = lambda _: None,
    ) -> Generator[tuple[int, Result]]:
        """Yield (number, work(number)) for all numbers, in the order in which they are done.

        Args:
            work: what is done; it is pickled and sent to the workers, and must give the same result on each.
            numbers: different from each other.
            report: called with a line whenever a worker was lost.

        Workers know what was added by name to this process. Those of this machine import the user's modules that `work`
        needs from where they are; to a Ray cluster the modules are sent.

        Raises:
            WorkersLost: nothing was done between `TRIES` losses of workers, or one piece of work lost as many.
            ValueError: Ray is not installed, its cluster is not found, or `work` cannot be pickled.
        """
        from joblib import Parallel, delayed  # here, as the command line needs no more of this module than its options

        piece = self._piece(work)
        missing, losses = dict.fromkeys(numbers), 0
        with self._workers(report, module_sources(piece.content) if isinstance(piece, _Piece) else ()):
            while missing:
                try:
                    # Workers that die early break the executor while work is still being submitted.
                    results = Parallel(
                        n_jobs=self.jobs or -1, return_as="generator_unordered", batch_size=1, max_nbytes=None
                    )(delayed(piece)(number) for number in list(missing))
                    with _closed(results):
                        for number, result in results:
                            losses = 0
                            yield number, result
                            del missing[number]
                except BrokenExecutor:
                    losses += 1
                    if losses == TRIES:
                        raise WorkersLost(
                            f"workers died {TRIES} times in a row; {len(missing)} chunks are left"
                        ) from None
                    report(f"a worker died; {len(missing)} chunks that are not done yet are run again")

    def _piece(self, work: Callable[[int], Result]) -> Callable[[int], tuple[int, Result]]:
        """Return the function that workers call: `work` itself here, otherwise pickled once with the additions."""
        import cloudpickle  # type: ignore[import-untyped]

        if self.jobs == 1:
            return lambda number: (number, work(number))
        try:
            content = cloudpickle.dumps((additions(), work))
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise ValueError(
                f"policies, or what was added by name, cannot be sent to other processes ({error}): use --jobs 1, or "
                "make them picklable"
            ) from None
        return _Piece(content, tuple(sys.path) if self.backend == "local" else ())

    @contextlib.contextmanager
    def _workers(self, report: Report, modules: Sequence[Path]) -> Iterator[None]:
        """Choose joblib's backend for what is run within."""
        from joblib import parallel_config

        if self.backend == "local":
            # loky replaces a worker whose memory has grown, and warns of it in a thread of its own. Where warnings are
            # errors, that would end the thread, and the work would never be done.
            warnings.filterwarnings("ignore", "A worker stopped", UserWarning)
            with parallel_config(backend="loky", inner_max_num_threads=1):
                yield
            return
        if self.address is None:
            # Ray reads this when it is imported. Without it even a cluster of one machine listens on all its
            # addresses, and everybody who can reach Ray's ports can run programs.
            os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # disables Ray's usage statistics
        try:
            from fuzzyarm.eval.sweep import ray_backend
        except ModuleNotFoundError as error:
            raise ValueError(
                f'{error.name} is not installed; in the repository: pip install -c constraints.txt -e ".[cluster]"'
            ) from None
        connected = ray_backend.cluster(self.address, self.jobs, modules)
        with connected, parallel_config(backend=ray_backend.NAME, report=report):
            yield


@contextlib.contextmanager
def _closed(results: Generator[Any]) -> Iterator[None]:
    """Close joblib's results after the block, without its warning that some were not consumed."""
    try:
        yield
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            results.close()


@dataclasses.dataclass(frozen=True)
class _Piece:
    """A piece of work as it travels to a worker.

    Attributes:
        content: additions and work, pickled. They stay so until the worker's `paths` are set, as unpickling may import
            the user's modules; and every piece gets a copy of its own, so that no policy carries memory to the next.
        paths: folders that the worker imports from, as the process that started the sweep does.
    """

    content: bytes
    paths: tuple[str, ...]

    def __call__(self, number: int) -> tuple[int, Any]:
        """Run the work for a number and return both."""
        sys.path += [path for path in self.paths if path not in sys.path]
        added, work = pickle.loads(self.content)
        adopt(added)
        return number, work(number)
