"""Atomic writing of files and folders."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

__all__ = ["write_atomically", "write_folder_atomically"]


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write `content` beside `path`, flush it to the disk, then rename it: nobody ever sees a partial file.

    Raises:
        OSError: the folder is missing or not writable; nothing is left behind.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            _flushed(file, data)
        os.chmod(name, 0o666 & ~_umask())  # mkstemp makes the file private
        os.replace(name, path)
        _sync_folder(path.parent)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def write_folder_atomically(folder: Path, files: Mapping[str, bytes | str]) -> None:
    """Write a folder with `files` by name beside `folder`, then rename it; a folder that is there is replaced.

    Raises:
        OSError: the parent folder is missing or not writable; what was there stays as it was.
    """
    aside = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        new = aside / "new"
        new.mkdir()
        for name, content in files.items():
            write_atomically(new / name, content)
        if folder.exists():
            os.replace(folder, aside / "old")
        try:
            os.replace(new, folder)
        except BaseException:
            if (aside / "old").exists():
                os.replace(aside / "old", folder)
            raise
        _sync_folder(folder.parent)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _flushed(file: BinaryIO, data: bytes) -> None:
    """Write to an open binary file and wait until the disk has it."""
    file.write(data)
    file.flush()
    os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Flush a rename to the disk; systems that cannot open a folder do not need this."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _umask() -> int:
    """Return the umask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
