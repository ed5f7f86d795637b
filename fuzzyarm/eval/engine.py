"""Pieces of work on many workers: joblib runs them in processes of this machine or on Ray's workers on a cluster.

When a worker dies, for example because memory runs out, only the running pieces are lost, and they are run again.
"""

import contextlib
import dataclasses
import os
import pickle
import pickletools
import socket
import sys
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any, TypeVar

from fuzzyarm.common.checks import choice, whole
from fuzzyarm.common.registry import Registry

__all__ = ["Engine", "WorkersLost", "source_of"]

_Result = TypeVar("_Result")
_TRIES = 3  # losses of workers, with no result in between, after which the work is given up
_INSTALLED = {"site-packages", "dist-packages"}  # names of the folders that Python packages are installed in


class WorkersLost(Exception):
    """Workers die repeatedly; the message says how often."""


@dataclasses.dataclass(frozen=True)
class Engine:
    """The workers, and how they are run.

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
        """Raise TypeError or ValueError if a value is not allowed."""
        choice("backend", self.backend, ("local", "ray"))
        if self.jobs is not None:
            whole("jobs", self.jobs, low=1)
        if self.address is not None and self.backend != "ray":
            raise ValueError(f"address {self.address!r} is for Ray clusters only: add --backend ray")
        if self.address is not None and self.address.startswith("ray://"):
            raise ValueError(
                f"address {self.address!r}: Ray clients are not supported; run on one of the cluster's machines, "
                "with --address auto or HOST:PORT"
            )

    def run(
        self, work: Callable[[int], _Result], numbers: Sequence[int], report: Callable[[str], None] = lambda _: None
    ) -> Generator[tuple[int, _Result]]:
        """Yield (number, work(number)) for all numbers, in the order in which the results arrive.

        Workers know the cases, metrics and policies that were added by name in this process. Workers on this machine
        import the user's modules that `work` needs from their folders; a Ray cluster gets copies.

        `work` is pickled and must give the same result in every worker; `numbers` are all different. `report` is called
        with a line of text whenever a worker has died.

        Raises:
            WorkersLost: workers died three times without a result in between.
            ValueError: Ray is not installed, its cluster is not found, or `work` cannot be pickled.
        """
        if self.jobs == 1:
            with self._workers(()):
                yield from ((number, work(number)) for number in numbers)
            return
        from joblib import Parallel, delayed  # here, because the command line needs only the options of this module

        # loky replaces a worker whose memory has grown, and warns in a separate thread: if warnings are errors, this
        # one would end that thread with the work undone. The other warning is about results that nobody consumed.
        warnings.filterwarnings("ignore", r"A worker stopped|\d+ tasks ", UserWarning)
        content, paths = _pickled(work), tuple(sys.path) if self.backend == "local" else ()
        missing, losses = dict.fromkeys(numbers), 0
        with self._workers(_module_sources(content)) as (jobs, lost):
            while missing:
                pieces = (delayed(_call)(content, paths, number) for number in list(missing))
                try:
                    # Workers that die early break the executor while work is still being submitted.
                    run = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1, max_nbytes=None)
                    with contextlib.closing(run(pieces)) as results:
                        for number, result in results:
                            losses = 0
                            yield number, result
                            del missing[number]
                except lost:
                    losses += 1
                    left = f"unfinished: {len(missing)} of {len(numbers)} parts of the work"
                    if losses == _TRIES:
                        raise WorkersLost(f"workers died {_TRIES} times in a row; {left}") from None
                    report(f"a worker died, and its work will be run again; {left}")

    @contextlib.contextmanager
    def _workers(self, modules: Sequence[Path]) -> Iterator[tuple[int, Any]]:
        """Context with joblib's backend; Ray's workers get copies of `modules`.

        It yields the number of workers (-1: one per core) and the exception classes raised if a worker dies.
        """
        from joblib import parallel_config

        if self.backend == "local":
            with parallel_config(backend="loky", inner_max_num_threads=1):
                yield self.jobs or -1, BrokenExecutor
            return
        if self.address is None:
            # Ray reads this when it is imported. Without it even a cluster of one machine listens on all its
            # addresses, and anybody who can reach Ray's ports can run programs.
            os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # disables Ray's usage statistics
        try:
            import ray
            from ray.util.joblib.ray_backend import RayBackend
        except ModuleNotFoundError as error:
            raise ValueError(
                f'{error.name} is not installed; run in the repository: pip install -c constraints.txt -e ".[cluster]"'
            ) from None
        backend = RayBackend()
        backend.supports_return_generator = True  # unlike joblib's own pool, Ray's returns results one by one
        with _cluster(ray, self.address, self.jobs, modules), parallel_config(backend=backend):
            cpus = max(1, int(ray.cluster_resources().get("CPU", 1)))
            kinds = "RayActor", "WorkerCrashed", "OutOfMemory", "NodeDied", "LocalRayletDied", "ObjectLost"
            lost = tuple(getattr(ray.exceptions, f"{kind}Error") for kind in kinds)
            try:
                yield min(self.jobs or cpus, cpus), lost
            except ray.exceptions.RuntimeEnvSetupError as error:
                raise ValueError(f"Ray cannot send the policies' modules: {str(error).splitlines()[0]}") from None


def _pickled(work: Callable[[int], Any]) -> bytes:
    """Return one pickle of `work` and the objects added to registries; each piece of work unpickles its own copy."""
    import cloudpickle  # type: ignore[import-untyped]

    try:
        content: bytes = cloudpickle.dumps((Registry.additions(), work))
    except (AttributeError, TypeError, pickle.PicklingError) as error:
        raise ValueError(
            f"a policy or an object that was added cannot be sent to other processes ({error}): use --jobs 1, or "
            "make it picklable"
        ) from None
    return content


def _call(content: bytes, paths: Sequence[str], number: int) -> tuple[int, Any]:
    """Unpickle a function in a worker, with `paths` on its import path, and return (number, function(number))."""
    sys.path += [path for path in paths if path not in sys.path]
    added, work = pickle.loads(content)
    Registry.adopt(added)
    return number, work(number)


@contextlib.contextmanager
def _cluster(ray: Any, address: str | None, jobs: int | None, modules: Sequence[Path]) -> Iterator[None]:
    """Connect to a Ray cluster for the block, or start one on this machine, and send it the modules.

    If this process is already connected to a cluster, that connection is used and kept.
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
            try:
                host, _, port = address.rpartition(":")
                if port.isdigit():  # Ray itself would try for minutes, and then exit the process
                    socket.create_connection((host, int(port)), timeout=10.0).close()
                ray.init(address=address, **options)
            except (OSError, RuntimeError, ValueError) as error:
                reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
                raise ValueError(
                    f"cannot connect to a Ray cluster at {address!r}: {reason}; if the cluster requires a token, set "
                    "RAY_AUTH_MODE=token"
                ) from None
        try:
            yield
        finally:
            # A thread of the pool that asks for a result after the shutdown would start another cluster.
            for thread in threading.enumerate():
                if type(thread).__module__ == "ray.util.multiprocessing.pool":
                    thread.join(timeout=10.0)
            ray.shutdown()


def _module_sources(pickled: bytes) -> tuple[Path, ...]:
    """Return the folders of the user's packages and the files of modules that a pickle refers to, each once."""
    words = {word.partition(".")[0] for _, word, _ in pickletools.genops(pickled) if isinstance(word, str)}
    sources = (source_of(top) for top in sorted(words & set(sys.modules)))
    return tuple(dict.fromkeys(source for source in sources if source is not None))


def source_of(top: str) -> Path | None:
    """Return the folder of the user's top-level package with this name, or the file of a module outside packages.

    None for a part of Python or of fuzzyarm, the main program, and installed packages, which all machines should have.
    """
    module = sys.modules[top]
    path = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
    if top in {"fuzzyarm", "__main__", "__mp_main__", *sys.stdlib_module_names} or path is None:
        return None
    file = Path(path).absolute()
    source = file.parent if file.name == "__init__.py" else file
    return None if _INSTALLED & set(source.parts) else source
