"""The standard streams of the command: closed ones, full ones, and those that lack letters."""

from __future__ import annotations

import contextlib
import io
import os
import sys

from fuzzyarm.cli.usage import UsageError
from fuzzyarm.common.console import SPELLED_OUT, naming_output

__all__ = ["discard_output", "finish_output", "open_streams"]


def open_streams() -> None:
    """Let every standard stream take whatever is printed.

    A closed one is opened on the null device, since otherwise the next file that is opened would get its number, and
    what is printed would go into that file. A letter that the encoding of a stream lacks is spelled out.

    Raises:
        UsageError: standard output is closed; what was asked for would be lost.
    """
    closed = [number for number in (0, 1, 2) if not _is_open(number)]
    for _ in closed:
        os.open(os.devnull, os.O_RDWR)  # gets the smallest free number
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=SPELLED_OUT)
    if sys.stdout is None or 1 in closed:
        raise UsageError("standard output is closed; send it to a file, or to /dev/null")


def finish_output() -> None:
    """Write what is still buffered; OSError if standard output does not take it, which Python itself tells too late."""
    with naming_output():
        sys.stdout.flush()


def discard_output() -> None:
    """Send what is still buffered nowhere, or Python would complain about it at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True
