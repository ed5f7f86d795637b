"""Pieces of work on many workers: joblib, over processes of this machine or over the tasks of a Ray cluster.

A worker that dies, for want of memory say, loses the pieces it was at, and nothing else: they are run again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from typing import TypeVar

from joblib import Parallel, delayed, parallel_config

Result = TypeVar("Result")
Report = Callable[[str], None]
TRIES = 3
"""How often a piece of work may lose its worker, or all workers their work, until it is given up."""


class WorkersLost(Exception):
    """Workers die again and again at the same work; the message says how often."""


@dataclasses.dataclass(frozen=True)
class Engine:
    """Where the work is done.

    Attributes:
        backend: "local", processes of this machine; or "ray".
        jobs: number of workers; None: one per core, or all CPUs of the cluster. 1 of the local ones is this process.
        address: of a Ray cluster, "auto" on one of its machines, or HOST:PORT; None: one is started on this machine.

    Raises:
        ValueError: a value is unknown, out of range or without use.
    """

    backend: str = "local"
    jobs: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if self.backend not in ("local", "ray"):
            raise ValueError(f"unknown backend {self.backend!r}; choose from: local, ray")
        if self.jobs is not None and (isinstance(self.jobs, bool) or not isinstance(self.jobs, int) or self.jobs < 1):
            raise ValueError(f"jobs = {self.jobs!r} is out of range; allowed: 1, 2, 3, ...")
        if self.address is not None and self.backend != "ray":
            raise ValueError(f"address {self.address!r} is of a Ray cluster: use it with --backend ray")
        if self.address is not None and self.address.startswith("ray://"):
            raise ValueError(
                f"address {self.address!r}: a Ray client cannot do this; run on one of the cluster's machines, "
                "with --address auto or HOST:PORT"
            )

    def run(
        self, work: Callable[[int], Result], numbers: Sequence[int], report: Report = lambda _: None
    ) -> Generator[tuple[int, Result]]:
        """Yield (number, work(number)) for all numbers, in the order in which they are done.

        Args:
            work: what is done; it travels to the workers, which must give the same result whoever does it.
            numbers: different from each other.
            report: called with a line whenever a worker was lost.

        Raises:
            WorkersLost: nothing was done between `TRIES` losses of workers, or one piece of work lost as many.
            ValueError: Ray is not installed, or its cluster is not found.
        """
        missing, losses = dict.fromkeys(numbers), 0
        with self._workers(report):
            while missing:
                results = Parallel(
                    n_jobs=self.jobs or -1, return_as="generator_unordered", batch_size=1, max_nbytes=None
                )(delayed(_numbered)(work, number) for number in list(missing))
                try:
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
                finally:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore", UserWarning)  # "... was not consumed"
                        results.close()

    @contextlib.contextmanager
    def _workers(self, report: Report) -> Iterator[None]:
        """Choose joblib's backend for what is run within."""
        if self.backend == "local":
            with parallel_config(backend="loky", inner_max_num_threads=1):
                yield
            return
        if self.address is None:
            # Read when Ray is imported: without it even a cluster of one machine listens on all its addresses, and
            # whoever reaches Ray's ports can run programs.
            os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent to Ray's makers
        try:
            from fuzzyarm.eval.sweep import ray_backend
        except ModuleNotFoundError as error:
            raise ValueError(f"{error.name} is not installed; pip install 'fuzzyarm[cluster]'") from None
        with ray_backend.cluster(self.address, self.jobs), parallel_config(backend=ray_backend.NAME, report=report):
            yield


def _numbered(work: Callable[[int], Result], number: int) -> tuple[int, Result]:
    return number, work(number)
