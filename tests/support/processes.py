"""Processes that tests start, kill and interrupt."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
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
