"""The error for incorrect usage, and checks of files and folders that several commands use."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from fuzzyarm.common.console import say
from fuzzyarm.common.files import locked_folder

__all__ = ["UsageError", "check_writable", "claimed_folder", "output_file", "stopped"]


class UsageError(Exception):
    """Bad usage; the message is the line that the user sees."""


@contextlib.contextmanager
def claimed_folder(folder: Path, *, make: bool = True) -> Iterator[None]:
    """Make a folder if needed, unless `make` is false, and let no other command write to it while the block runs.

    A new folder that is still empty at the end, because the command was refused, is removed. UsageError before any
    computation if the folder cannot be made or written to; ValueError if another process writes to it.
    """
    if not make and not folder.is_dir():  # the reader of the folder gives a better message
        yield
        return
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        check_writable(folder, make=True)
        with locked_folder(folder):
            yield
    finally:
        with contextlib.suppress(OSError):  # at the first folder that is not empty
            for one in made:
                one.rmdir()


def check_writable(folder: Path, *, make: bool = False) -> None:
    """With `make`, make the folder; raise UsageError if no file can be written to it, before anything is computed."""
    try:
        if make:
            folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"cannot write to {folder}: {error.strerror or error}") from None


def output_file(path: Path | None, suffix: str, option: str = "--out") -> None:
    """Raise UsageError before anything is computed unless the file, if given, ends in `suffix` and can be written."""
    if path is None:
        return
    if path.suffix != suffix or path.is_dir():
        raise UsageError(f"{option} {path} must be a file ending in {suffix}")
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: the folder {path.parent} does not exist; create it first")
    check_writable(path.parent)


def stopped(command: str, out: Path, error: BaseException) -> int:
    """Print why a command ended early and how to continue it; return its exit code: 130 if interrupted, else 1."""
    interrupted = isinstance(error, KeyboardInterrupt)
    reason = "interrupted" if interrupted else error
    say(f"fuzzyarm {command}: {reason}; finished work is kept: continue with --resume --out {out}", error=True)
    return 130 if interrupted else 1
