"""A surface is what bad input is thrown at; a try is run under bounds, and judged."""

from __future__ import annotations

import contextlib
import dataclasses
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
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded

import fuzzyarm
from fuzzyarm.common.checks import shown

__all__ = ["Broken", "Surface", "Tally", "Try", "bounded", "described", "try_all"]

SECONDS = 10.0  # of processor time that a try may take; no refusal takes a tenth of it
MEMORY = 3 * 2**30  # bytes that a try may add
LONGEST = 1500  # characters of a message
STUCK = 1800  # s of wall time after which a try that does not come back ends the process
UNSAFE = ("Cc", "Cf", "Cs", "Zl", "Zp")  # control characters, signs of direction, half surrogates, ends of lines
PACKAGE = str(Path(fuzzyarm.__file__).parent)
DOCUMENTED = (TypeError, ValueError, OSError, ResetNeeded, gymnasium.error.Error)


class Broken(Exception):
    """What should not have been accepted was, or gave a wrong result."""


class _TooLong(BaseException):
    """The bound on processor time."""


@dataclasses.dataclass(frozen=True)
class Try:
    """One piece of bad input.

    Attributes:
        what: describes it.
        run: returns if the input was accepted and gave a right result; otherwise raises the error that a user sees, or
            `Broken`.
        names: what the message of an error has to contain at least one of; empty: anything.
    """

    what: str
    run: Callable[[], object]
    names: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Surface:
    """Something that takes input.

    Attributes:
        name: in tables.
        group: the heading under which it is counted.
        count: tries of a whole run.
        make: a try from a random generator.
        raises: other documented errors.
        prepare: called once before the tries, outside the bounds: makes samples, and lets machine code be made.
    """

    name: str
    group: str
    count: int
    make: Callable[[np.random.Generator], Try]
    raises: tuple[type[BaseException], ...] = ()
    prepare: Callable[[], object] = lambda: None

    def number(self, k: int) -> Try:
        """Try number k, the same on every machine."""
        return self.make(np.random.default_rng([zlib.crc32(self.name.encode()), k]))


@dataclasses.dataclass
class Tally:
    """What came of the tries of a surface: so many tried, refused and accepted; the others are broken."""

    surface: str
    tried: int = 0
    refused: int = 0
    accepted: int = 0
    broken: list[str] = dataclasses.field(default_factory=list)


def try_all(surface: Surface, numbers: range, at: Callable[[int], None] = lambda k: None) -> Tally:
    """Run tries by number; `at` hears of each before it begins."""
    tally = Tally(surface.name)
    surface.prepare()
    for k in numbers:
        at(k)
        tally.tried += 1
        label = "making the try"
        try:
            one = surface.number(k)
            label = one.what
            accepted = _held(one, surface.raises)
        except Broken as error:
            tally.broken.append(f"{surface.name} --only {k}: {label}: {error}")
        except Exception as error:
            tally.broken.append(f"{surface.name} --only {k}: {label}: {_last_line(error)}")
        else:
            tally.accepted += accepted
            tally.refused += not accepted
    return tally


def _held(one: Try, raises: tuple[type[BaseException], ...]) -> bool:
    """Run a try; return whether its input was accepted, raise Broken if the rules are broken."""
    begin = time.process_time()
    try:
        with bounded(), warnings.catch_warnings():
            warnings.simplefilter("error")
            one.run()
        accepted = True
    except Broken:
        raise
    except raises:
        accepted = False
    except DOCUMENTED as error:
        _check_message(error, one.names)
        accepted = False
    except _TooLong:
        raise Broken(f"takes more than {SECONDS:g} s") from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise Broken(f"{type(error).__name__}: {_last_line(error)}") from error
    if time.process_time() - begin > SECONDS:
        raise Broken(f"took {time.process_time() - begin:.1f} s")
    return accepted


def _check_message(error: BaseException, names: tuple[str, ...]) -> None:
    """Check that an error is raised on purpose, and its message one line that names the value."""
    text, frame = str(error), _innermost(error.__traceback__)
    where = f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno}: {text[:200]!r}"
    from_system = isinstance(error, OSError) and error.errno is not None
    # A keyword that a function does not have: Python itself says so, at the call.
    from_call = isinstance(error, TypeError) and "argument" in text and not frame.filename.startswith(PACKAGE)
    from_gymnasium = isinstance(error, gymnasium.error.Error)  # whose seeds are its own
    if not (from_system or from_call or from_gymnasium):
        line = linecache.getline(frame.filename, frame.lineno or 0).strip()
        if not (frame.filename.startswith(PACKAGE) and line.startswith("raise ")):
            raise Broken(f"not an error of its own: {where}")
    if not text or len(text) > LONGEST:
        raise Broken(f"a message of {len(text)} characters: {where}")
    if any(unicodedata.category(one) in UNSAFE for one in text):
        raise Broken(f"a message with line breaks or control characters: {where}")
    if names and not any(name and name in text for name in names):
        raise Broken(f"the message names none of {[name[:40] for name in names]}: {where}")


def _innermost(trace: TracebackType | None) -> traceback.FrameSummary:
    return traceback.extract_tb(trace)[-1]


def _last_line(error: BaseException) -> str:
    try:
        frame = _innermost(error.__traceback__)
        return f"{type(error).__name__}: {str(error)[:200]!r} at {Path(frame.filename).name}:{frame.lineno}"
    except Exception:
        return type(error).__name__


def described(value: Any) -> str:
    """A value for the description of a try."""
    try:
        text = shown(value)
    except Exception:
        text = object.__repr__(value)
    return f"{type(value).__name__} {text[:100]}"


@contextlib.contextmanager
def bounded() -> Iterator[None]:
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
