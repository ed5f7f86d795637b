"""If writing is interrupted at any point, a file or folder is the old or the new one, and never a part of either."""

import contextlib
import csv
import io
import os
import stat
import subprocess
from unittest import mock

import pytest
from support.processes import running

from fuzzyarm.common.files import csv_text, locked_folder, write_atomically, write_folder_atomically


@pytest.mark.parametrize(("content", "expected"), [("Γ\n", "Γ\n".encode()), (b"\x00\r\n", b"\x00\r\n"), ("", b"")])
def test_it_is_written_as_it_is(tmp_path, content, expected):
    write_atomically(tmp_path / "file", content)
    assert (tmp_path / "file").read_bytes() == expected
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_its_mode_is_that_of_any_new_file_and_of_what_it_replaces(tmp_path, monkeypatch, umask):
    path, folder, before = tmp_path / "file", tmp_path / "folder", os.umask(umask)
    try:
        with monkeypatch.context() as patched:
            patched.setattr(os, "umask", None)  # of the whole process: another thread's file would be open to all
            patched.setattr(os, "chmod", None)
            write_atomically(path, "")
            write_folder_atomically(folder, {"inner": ""})
    finally:
        os.umask(before)
    assert mode(path) == mode(folder / "inner") == 0o666 & ~umask and mode(folder) == 0o777 & ~umask
    path.chmod(0o600)
    folder.chmod(0o700)
    write_atomically(path, "new")
    write_folder_atomically(folder, {"inner": ""})
    assert mode(path) == 0o600 and mode(folder) == 0o700


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_a_text_that_a_spreadsheet_would_compute_is_marked_as_text():
    texts = ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "'quoted", "plain", "a=1"]
    rows = [{"policy": text, "error": -1.5, "count": 3} for text in texts]
    read = list(csv.DictReader(io.StringIO(csv_text(rows), newline="")))
    assert [row["policy"] for row in read] == [*(f"'{text}" for text in texts[:5]), r"'\r=1", *texts[6:]]
    assert {(row["error"], row["count"]) for row in read} == {("-1.5", "3")}
    assert csv_text([{"b": None}], ["a", "b"], header=False) == ",\n"


HOLD = """
import pathlib, sys
from fuzzyarm.common.files import locked_folder
with locked_folder(pathlib.Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.read()
"""


def test_a_folder_is_locked_for_others_until_its_process_is_dead(tmp_path):
    with running(HOLD, str(tmp_path), stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == "locked\n"
        with pytest.raises(ValueError, match="another process is writing to"), locked_folder(tmp_path):
            pass
        process.kill()
        process.wait()
        with locked_folder(tmp_path):
            pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
@pytest.mark.parametrize("step", ["open", "fdopen", "fsync", "replace"])
def test_whatever_fails_the_old_file_stays_and_nothing_is_left(tmp_path, monkeypatch, step, error):
    path = tmp_path / "file"
    path.write_text("old")
    monkeypatch.setattr(os, step, mock.Mock(side_effect=error(28, "No space left on device")))
    with pytest.raises(error) as raised:
        write_atomically(path, "new")
    monkeypatch.undo()
    assert path.read_text() == "old" and [one.name for one in tmp_path.iterdir()] == ["file"]
    assert error is KeyboardInterrupt or raised.value.filename == str(path)


def test_the_disk_has_the_content_before_the_name_and_then_the_name(tmp_path, monkeypatch):
    done, fsync, replace = [], os.fsync, os.replace

    def kind(handle):
        return "folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file"

    monkeypatch.setattr(os, "fsync", lambda handle: (done.append(kind(handle)), fsync(handle)))
    monkeypatch.setattr(os, "replace", lambda *names: (done.append("rename"), replace(*names)))
    write_atomically(tmp_path / "file", "content")
    assert done == ["file", "rename", "folder"]


def content_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("fails_at", range(1, 6))
def test_a_folder_is_replaced_whole_or_stays(tmp_path, monkeypatch, existing, fails_at):
    """Renames are: two files, the old folder aside, the new one into its place."""
    folder, calls, replace = tmp_path / "folder", [], os.replace
    if existing:
        write_folder_atomically(folder, {"old": ""})
    before = content_of(folder) if existing else None

    def sometimes(*names):
        calls.append(names)
        if len(calls) == fails_at:
            raise OSError(5, "Input/output error")
        replace(*names)

    monkeypatch.setattr(os, "replace", sometimes)
    fails = fails_at <= (4 if existing else 3)
    with pytest.raises(OSError, match="Input/output") if fails else contextlib.nullcontext():
        write_folder_atomically(folder, {"a": "1", "b": b"2"})
    found = content_of(folder) if folder.exists() else None
    assert found == (before if fails else {"a": b"1", "b": b"2"})
    assert list(tmp_path.iterdir()) == ([folder] if folder.exists() else [])
