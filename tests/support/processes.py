"""Processes that tests start, kill and interrupt."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

# A process that is started in the background, and so its children, may ignore SIGINT.
_INTERRUPTIBLE = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"


@contextlib.contextmanager
def running(program: str, *arguments: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Run a Python program that SIGINT interrupts, in a session of its own; whatever is left of it is killed."""
    command = [sys.executable, "-c", _INTERRUPTIBLE + program, *arguments]
    with subprocess.Popen(command, text=True, start_new_session=True, **options) as process:
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def wait_until(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait until something is true that a running process brings about; pytest's own limit ends the waiting."""
    while not condition():
        assert process.poll() is None, f"the process ended with {process.returncode} before it was time"
        time.sleep(0.01)
