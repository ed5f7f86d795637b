"""If writing is interrupted at any point, a file or folder is the old or the new one, and never a part of either."""

import os
import stat

import pytest

from fuzzyarm.common.files import write_atomically, write_folder_atomically

STEPS = ["mkstemp", "fdopen", "fsync", "chmod", "replace"]


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
        assert os.umask(umask) == umask  # reading it has not changed it
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o666 & ~umask


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["disk", "signal"])
@pytest.mark.parametrize("step", STEPS)
def test_whatever_fails_the_old_file_stays_and_nothing_is_left(tmp_path, monkeypatch, step, error):
    path = tmp_path / "file"
    path.write_text("old")

    def fail(*_, **__):
        raise error

    monkeypatch.setattr("tempfile.mkstemp" if step == "mkstemp" else f"os.{step}", fail)
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
