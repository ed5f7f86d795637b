"""Compilation by Numba, with a cache on disk that follows every source that a kernel is made from."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import os
import secrets
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from numba import config, njit
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import FunctionCache
from numba.core.codegen import get_host_cpu_features
from numba.core.dispatcher import Dispatcher

__all__ = ["announced_compilation", "kernel", "kernel_for", "without_kernels"]

_PACKAGE = Path(__file__).parents[2]
_NUMBERS = 60  # bits


def _number_functions() -> None:
    """Let Numba count functions from a random number on.

    The count reaches the names in the machine code. Counted from 1 in every process, two helpers of one name that were
    compiled in different processes, such as the same law's for two robots, may have the same number; when both are read
    from disk, one of them would run in place of the other.
    """
    FunctionIdentity._unique_ids = itertools.count(secrets.randbits(_NUMBERS))


def _use_whole_vectors() -> None:
    """Let LLVM use vectors of 512 bits on processors that have them.

    By default it stops at 256 bits, which spares power. Wider vectors round no differently. A user's own
    NUMBA_CPU_NAME and NUMBA_CPU_FEATURES stand, and functions that are compiled already stay as they are.
    """
    features = get_host_cpu_features()
    if config.CPU_NAME is None and config.CPU_FEATURES is None and "+avx512f" in features.split(","):
        config.CPU_FEATURES = f"{features},-prefer-256-bit"


_use_whole_vectors()
_number_functions()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_number_functions)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function` with Numba and cache the machine code on disk, see `kernel_for`."""
    return kernel_for("")(function)


def kernel_for(made_for: str) -> Callable[[Callable[..., Any]], Any]:
    """Return the decorator that compiles a function with Numba and caches the machine code on disk.

    Numba's cache only watches the file that defines the function: an edit in `dynamics` or `friction`, called from
    it, would leave stale machine code in use. A digest of all sources that it may use, in the function's name from
    which the cache file is named, prevents that. Without a writable cache folder the function is compiled anew.

    Args:
        made_for: what tells the function from others that were made by the same lines: the digest of the equations
            that are compiled into it.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        function.__qualname__ = "_".join([function.__qualname__, made_for, _digest(_rooms(function))])
        dispatcher = njit(error_model="numpy", nogil=True)(function)
        with contextlib.suppress(RuntimeError):
            dispatcher._cache = _CacheByName(function)
        return dispatcher

    return compiled


def without_kernels(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes of an object without its kernels, as they are pickled.

    A kernel that was made for some equations is not pickled: its parts were made by functions, too. The object holds it
    in a cached property, which makes it again in the other process.
    """
    return {name: value for name, value in attributes.items() if not isinstance(value, Dispatcher)}


class _CacheByName(FunctionCache):  # type: ignore[misc]
    """Numba's cache, for functions whose name says all that they are made from.

    Numba would tell functions made by the same lines from each other by what they refer to, pickled: that takes long,
    and comes out differently in the next process.
    """

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        return signature, codegen.magic_tuple()


@contextlib.contextmanager
def announced_compilation() -> Iterator[None]:
    """Print on a terminal what is being compiled, if the first calls in the block take more than a second."""
    global _compiled
    if _compiled or not sys.stderr.isatty():
        yield
    else:
        message = "FuzzyArm: compiling the simulation, once on this machine (up to a minute) ..."
        timer = threading.Timer(1.0, lambda: print(message, file=sys.stderr, flush=True))
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
    _compiled = True


_compiled = False


def _rooms(function: Callable[..., Any]) -> tuple[str, ...]:
    """Return the folders of the package from which a function's machine code may come."""
    source = Path(function.__code__.co_filename)
    room = source.relative_to(_PACKAGE).parts[0] if source.is_relative_to(_PACKAGE) else "envs"
    # A law may use the layouts of other laws; the kernels of `envs` use nothing of them.
    return ("common", "envs") if room == "envs" else tuple(sorted({"common", "envs", "fuzzy_policy", room}))


@functools.cache
def _digest(rooms: tuple[str, ...]) -> str:
    """Return a digest of all sources in folders of the package."""
    sources = [path for room in rooms for path in sorted((_PACKAGE / room).rglob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:12]
