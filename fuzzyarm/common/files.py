"""Atomic writing of files and folders, CSV tables, and a lock for folders being written.

A new file gets the mode that the umask allows; a replaced file never becomes readable by more users than before.
"""

import contextlib
import csv
import io
import os
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

if sys.platform != "win32":
    import fcntl

__all__ = ["csv_text", "locked_folder", "write_atomically", "write_folder_atomically", "write_once"]

_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet evaluates a cell that begins with one of these


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write `content` beside `path`, flush it to the disk, then rename it: a reader never sees a partial file."""
    data = content.encode("utf-8") if isinstance(content, str) else content
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), _mode(path, 0o666))
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, path)
            _sync_folder(path.parent)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
    except OSError as error:
        if error.filename is None and error.errno is not None:  # the disk is full
            error.filename = str(path)
        raise


def write_once(folder: Path, files: Mapping[str, bytes | str]) -> list[Path]:
    """Write files by name into a folder; return their paths. ValueError if a name exists there with other content."""
    contents = {folder / name: text.encode() if isinstance(text, str) else text for name, text in files.items()}
    for path, content in contents.items():
        if path.exists() and (path.stat().st_size != len(content) or path.read_bytes() != content):
            raise ValueError(f"{path} already exists with different content: remove it, or choose another folder")
    for path, content in contents.items():
        write_atomically(path, content)
    return list(contents)


def write_folder_atomically(folder: Path, files: Mapping[str, bytes | str]) -> None:
    """Write `files` (content by name) to a new folder, then rename it to `folder`; an existing folder is replaced."""
    aside = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        new = aside / "new"
        new.mkdir(_mode(folder, 0o777) | stat.S_IRWXU)
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


@contextlib.contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Lock a folder while the block runs, if the system can lock it; ValueError if another process has locked it."""
    if sys.platform == "win32":
        yield
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"another process is writing to {folder}; wait until it ends, or choose another folder"
            ) from None
        except OSError:  # some network file systems
            pass
        yield
    finally:
        os.close(handle)


def csv_text(rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None, *, header: bool = True) -> str:
    """Return rows, mappings from column to entry, as CSV; by default with the columns of the first row.

    A missing entry stays empty. A string that a spreadsheet would evaluate is prefixed with an apostrophe.
    """
    names = list(rows[0] if columns is None else columns)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if header:
        writer.writerow(map(_inert, names))
    writer.writerows([_inert(row.get(name)) for name in names] for row in rows)
    return text.getvalue()


def _inert(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    text = f"'{value}" if value.startswith(_FORMULA) else value
    return text.replace("\r", "\\r")  # which `csv` does not quote before Python 3.13


def _mode(path: Path, new: int) -> int:
    """Return the mode for a file or folder before the umask: `new`, restricted to the mode of an existing `path`."""
    try:
        return new & stat.S_IMODE(path.stat().st_mode)
    except OSError:
        return new


def _sync_folder(folder: Path) -> None:
    """Flush a rename to the disk; systems that cannot open a folder do not need this."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
