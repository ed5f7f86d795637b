"""How input is tried: under bounds on time and memory, and what has to come of it."""

from __future__ import annotations

import contextlib
import faulthandler
import linecache
import os
import resource
import signal
import sys
import time
import traceback
import unicodedata
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, settings

import fuzzyarm
from fuzzyarm.common.console import escaped

__all__ = ["Broken", "examples", "held"]

SECONDS = 150.0  # of processor time, the compilation of laws on an empty cache included
MEMORY = 3 * 2**30  # bytes that a try may add
LONGEST = 1500  # characters of a message
STUCK = 850.0  # s, after which a process that hangs in native code is ended
UNSAFE = ("Cc", "Cf", "Cs", "Zl", "Zp")  # control characters, signs of direction, half surrogates, ends of lines
PACKAGE = str(Path(fuzzyarm.__file__).parent)
TIMES = float(os.environ.get("ABUSE_TIMES", "1"))


class Broken(AssertionError):
    """What should not have been accepted was, or gave a wrong result, or was refused wrongly."""


class _TooLong(BaseException):
    """The bound on processor time."""


def examples(count: int) -> Any:
    """Return settings of hypothesis: always the same examples, ABUSE_TIMES as many; more than once: other ones."""
    return settings(
        max_examples=max(1, round(count * TIMES)),
        derandomize=TIMES <= 1.0,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


def held(run: Callable[[], object], names: tuple[str, ...] = ()) -> bool:
    """Run a try; return whether its input was accepted, raise `Broken` if it was neither taken nor refused well.

    Args:
        run: returns if the input was accepted and gave a right result; otherwise raises the error that a user sees.
        names: what the message of an error has to contain at least one of; empty: anything.
    """
    begin = time.process_time()
    try:
        with _bounded(), warnings.catch_warnings():
            warnings.simplefilter("error")
            run()
        accepted = True
    except (Broken, KeyboardInterrupt):
        raise
    except MemoryError:  # valid, and larger than the machine
        accepted = False
    except (TypeError, ValueError, OSError) as error:
        _check_error(error, names)
        accepted = False
    except _TooLong:
        raise Broken(f"takes more than {SECONDS:g} s") from None
    except BaseException as error:
        raise Broken(f"{type(error).__name__}: {_last_line(error)}") from error
    if time.process_time() - begin > SECONDS:
        raise Broken(f"took {time.process_time() - begin:.1f} s")
    return accepted


def _check_error(error: BaseException, names: tuple[str, ...]) -> None:
    """Check that an error is raised on purpose; as a command prints it, it is one line that names the value."""
    text, frame = str(error), traceback.extract_tb(error.__traceback__)[-1]
    where = f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno}: {text[:200]!r}"
    from_system = isinstance(error, OSError) and error.errno is not None
    if not from_system:
        line = linecache.getline(frame.filename, frame.lineno or 0).strip()
        if not (frame.filename.startswith(PACKAGE) and line.startswith("raise ")):
            raise Broken(f"not an error of its own: {where}") from error
    said = escaped(str(error.strerror) if from_system else text)  # type: ignore[attr-defined]
    if not said or len(said) > LONGEST:
        raise Broken(f"a message of {len(said)} characters: {where}")
    if any(unicodedata.category(one) in UNSAFE for one in said):
        raise Broken(f"a message with line breaks or control characters: {where}")
    if names and not any(name and name in text for name in names):
        raise Broken(f"the message names none of {[name[:40] for name in names]}: {where}")


def _last_line(error: BaseException) -> str:
    try:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return f"{str(error)[:200]!r} at {Path(frame.filename).name}:{frame.lineno}"
    except Exception:
        return type(error).__name__


@contextlib.contextmanager
def _bounded() -> Iterator[None]:
    """Bound processor time and memory while the block runs; a process that hangs in native code is ended."""

    def stop(*_: object) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGPROF, stop)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    limit = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY if pages else soft
    faulthandler.dump_traceback_later(STUCK, exit=True, file=sys.__stderr__)
    try:
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGPROF, before)
