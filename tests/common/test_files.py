"""If writing is interrupted at any point, a file or folder is the old or the new one, and never a part of either."""

import csv
import io
import os
import stat
import subprocess

import pytest
from support.processes import running

from fuzzyarm.common.files import csv_text, locked_folder, write_atomically, write_folder_atomically

STEPS = ["open", "fdopen", "fsync", "replace"]


@pytest.mark.parametrize(("content", "expected"), [("Γ\n", "Γ\n".encode()), (b"\x00\r\n", b"\x00\r\n"), ("", b"")])
def test_it_is_written_as_it_is(tmp_path, content, expected):
    write_atomically(tmp_path / "file", content)
    assert (tmp_path / "file").read_bytes() == expected
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_its_mode_is_that_of_any_new_file(tmp_path, umask):
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "file", "")
        write_folder_atomically(tmp_path / "folder", {"inner": ""})
        assert os.umask(umask) == umask
    finally:
        os.umask(before)
    assert mode(tmp_path / "file") == mode(tmp_path / "folder" / "inner") == 0o666 & ~umask
    assert mode(tmp_path / "folder") == 0o777 & ~umask


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_the_umask_is_never_touched(tmp_path, monkeypatch):
    """It is of the whole process: a file that another thread makes meanwhile would be open to everybody."""
    monkeypatch.setattr(os, "umask", None)
    monkeypatch.setattr(os, "chmod", None)
    write_atomically(tmp_path / "file", "")
    write_folder_atomically(tmp_path / "folder", {"inner": ""})


def test_what_is_replaced_does_not_become_readable_for_more_users(tmp_path):
    path, folder = tmp_path / "file", tmp_path / "folder"
    path.write_text("secret")
    path.chmod(0o600)
    folder.mkdir(mode=0o700)
    write_atomically(path, "new")
    write_folder_atomically(folder, {"inner": ""})
    assert mode(path) == 0o600 and mode(folder) == 0o700


def test_an_error_names_the_file(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError) as raised:
        write_atomically(tmp_path / "file", "")
    assert raised.value.filename == str(tmp_path / "file")


def test_a_text_that_a_spreadsheet_would_compute_is_marked_as_text():
    texts = ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "'quoted", "plain", "a=1"]
    rows = [{"policy": text, "error": -1.5, "count": 3} for text in texts]
    read = list(csv.DictReader(io.StringIO(csv_text(rows), newline="")))
    assert [row["policy"] for row in read] == [*(f"'{text}" for text in texts[:5]), r"'\r=1", *texts[6:]]
    assert {(row["error"], row["count"]) for row in read} == {("-1.5", "3")}


def test_a_column_that_a_row_lacks_stays_empty():
    assert csv_text([{"a": 1}], ["a", "b"]) == "a,b\n1,\n"
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


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["disk", "signal"])
@pytest.mark.parametrize("step", STEPS)
def test_whatever_fails_the_old_file_stays_and_nothing_is_left(tmp_path, monkeypatch, step, error):
    path = tmp_path / "file"
    path.write_text("old")

    def fail(*_, **__):
        raise error

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(type(error)):
        write_atomically(path, "new")
    monkeypatch.undo()
    assert path.read_text() == "old" and [one.name for one in tmp_path.iterdir()] == ["file"]


def test_the_disk_has_the_content_before_the_name_and_then_the_name(tmp_path, monkeypatch):
    done, fsync, replace = [], os.fsync, os.replace

    def kind(handle):
        return "folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file"

    monkeypatch.setattr(os, "fsync", lambda handle: (done.append(kind(handle)), fsync(handle)))
    monkeypatch.setattr(os, "replace", lambda *names: (done.append("rename"), replace(*names)))
    write_atomically(tmp_path / "file", "content")
    assert done == ["file", "rename", "folder"]


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "no" / "file", "")
    with pytest.raises(FileNotFoundError):
        write_folder_atomically(tmp_path / "no" / "folder", {})


def content_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_folder_is_replaced_whole(tmp_path):
    folder = tmp_path / "folder"
    write_folder_atomically(folder, {"a": "1", "b": b"2"})
    assert content_of(folder) == {"a": b"1", "b": b"2"}
    write_folder_atomically(folder, {"c": "3"})
    assert content_of(folder) == {"c": b"3"} and list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("fails_at", range(1, 5))
def test_a_folder_that_cannot_be_replaced_stays(tmp_path, monkeypatch, existing, fails_at):
    """Renames are: two files, the old folder aside, the new one into its place."""
    folder, count, replace = tmp_path / "folder", 0, os.replace
    if existing:
        write_folder_atomically(folder, {"old": ""})
    renames = 4 if existing else 3

    def sometimes(*names):
        nonlocal count
        count += 1
        if count == fails_at:
            raise OSError(5, "Input/output error")
        replace(*names)

    monkeypatch.setattr(os, "replace", sometimes)
    if fails_at <= renames:
        with pytest.raises(OSError, match="Input/output"):
            write_folder_atomically(folder, {"a": "1", "b": "2"})
        assert content_of(folder) == {"old": b""} if existing else not folder.exists()
    else:
        write_folder_atomically(folder, {"a": "1", "b": "2"})
        assert set(content_of(folder)) == {"a", "b"}
    assert list(tmp_path.iterdir()) == ([folder] if folder.exists() else [])
