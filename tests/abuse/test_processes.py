"""Commands in processes of their own: killed, interrupted, on a full disk, two in one folder, in other surroundings.

A process is stopped where it touches the disk, at the n-th file that it opens to write, renames, makes or removes: no
wall time decides, and each place can be tried.
"""

from __future__ import annotations

import contextlib
import csv
import functools
import io
import json
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import zipfile
from collections.abc import Sequence
from multiprocessing import forkserver
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from support.command_line import without_progress
from support.trainings import SMALL_TRAINING

from . import samples
from .judged import Broken
from .samples import scratch

pytestmark = pytest.mark.slow

TRAIN = ["train", "ppo", "--out", "out"]
for _name, _value in SMALL_TRAINING.items():
    TRAIN += [f"--{_name.replace('_', '-')}", *map(str, _value if isinstance(_value, tuple) else (_value,))]
SWEEP = ["sweep", "--policy", "fuzzy-1", "--case", "nominal", "--plants", "4", "--chunk", "2"]
PROVE = ["prove", "--policy", "fuzzy-4-tip", "--steps", "2"]
COMMANDS = {
    "evaluate": ["evaluate", "--policy", "fuzzy-1", "--case", "nominal", "--out", "out"],
    "sweep": [*SWEEP, "--jobs", "1", "--out", "out"],
    "train": TRAIN,
    "design": ["design", "--rules", "1", "--out", "out/controller.json"],
    "report": ["report", "evaluation", "--out", "out/report.html"],
    "tune": ["tune", "--out", "out", "--jobs", "1"],
    "prove": [*PROVE, "--out", "out/bound.json"],
    "prove by cells": [*PROVE, "--set", "set.toml", "--cells", "damping-1", "2", "--out", "out/cells.json"],
    "dataset": ["dataset", "--level", "medium", "--episodes", "1", "--out", "out"],
    "linearise": ["linearise", "fuzzy-1", "--out", "out"],
    **{f"export {kind}": ["export", kind, "fuzzy-1", "--out", "out"] for kind in ("c", "fmu", "onnx")},
    "identify": ["identify", "log.csv", "--out", "out/arm.toml", "--figure", "out/figure.png"],
}  # fmt: skip
NEW = ("sweep", "train", "tune")  # which want a new folder
RESUMED = {
    "sweep": ["sweep", "--resume", "--jobs", "1", "--out", "out"],
    "train": TRAIN,
    "tune": ["tune", "--resume", "--out", "out", "--jobs", "1"],
}
CODES = (0, 1, 2, 130, 141)
PATIENCE = 600  # s of wall time after which a process that does not end is stuck
FULL = 2000  # bytes that fit on the full disk; no line of an error is longer
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class Run:
    """A command that runs in a folder, in a process that is forked with the package loaded."""

    def __init__(self, words: Sequence[str], folder: Path, **how: Any) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([f"{__package__}.preloaded"])
        with mock.patch.dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)):  # Python 3.11 does not hand it on
            forkserver.ensure_running()
        self.process = context.Process(target=_command, args=(list(words), str(folder), how))
        self.process.start()
        self.folder = folder

    def wait(self) -> int:
        self.process.join(PATIENCE)
        if self.process.exitcode is None:
            self.process.kill()
            raise Broken(f"still running after {PATIENCE} s")
        return self.process.exitcode

    @property
    def err(self) -> str:
        return (self.folder / "stderr").read_text(errors="replace")


def _command(words: list[str], folder: str, how: dict[str, Any]) -> None:
    """Run a command line as the installed program does; see `test_a_command_that_is_stopped` for `how`."""
    os.chdir(folder)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # as Python itself sets it
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    sys.stdout, sys.stderr = (open(handle, "w", closefd=False) for handle in (1, 2))  # noqa: SIM115
    if "largest" in how:
        resource.setrlimit(resource.RLIMIT_FSIZE, (how["largest"], how["largest"]))
    _stand_ins()
    count = _counted(folder, how.get("at", -1), how.get("signal", signal.SIGKILL))
    from fuzzyarm.cli import main

    try:
        code = main(words)
        sys.stdout.flush()
    except KeyboardInterrupt:  # outside the command
        code = 130
    except OSError:  # the last flush, as at the end of Python
        code = 120
    with contextlib.suppress(OSError):
        sys.stderr.flush()
    if "count" in how:
        Path("count").write_text(str(count[0]))
    os._exit(code)


def _counted(folder: str, at: int, number: int) -> list[int]:
    """Count what touches the disk in a folder; before the one of a number the process gets a signal."""
    count = [0]
    out = os.path.join(os.path.realpath(folder), "out")

    def touched(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            if not arguments[2] & WRITING:
                return
        elif event not in ("os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.link", "os.truncate"):
            return
        name = arguments[1] if event == "os.rename" else arguments[0]
        if isinstance(name, bytes | str | os.PathLike) and os.path.realpath(os.fsdecode(name)).startswith(out):
            count[0] += 1
            if count[0] == at + 1:
                os.kill(os.getpid(), number)

    sys.addaudithook(touched)
    return count


def _stand_ins() -> None:
    """Let searches that take minutes find at once what they would find, so that all that is left is what is written."""
    from fuzzyarm.eval.stability import _linearisation as linearisation
    from fuzzyarm.eval.tuning import _search as search
    from fuzzyarm.eval.tuning import _steps as steps
    from fuzzyarm.eval.tuning import run
    from fuzzyarm.identification import _two_joints

    def step(policy: str, chosen: Any) -> Any:
        return steps.TuningStep(policy, 1, lambda context: search.Found(chosen, {}, {"nominal": 0.9}, 1))

    run.steps_for = lambda arm: (step("computed-torque", {"bandwidth": 40.0}), step("elastic-observer", None))
    linearisation.POSTURES = 2
    _two_joints._STEPS = _two_joints._ELASTIC_STEPS = _two_joints._MORE_STEPS = 1


def begun(name: str) -> Path:
    folder = scratch()
    if name not in NEW:
        (folder / "out").mkdir()
    if name == "report":
        shutil.copytree(samples.evaluated(), folder / "evaluation")
    if name == "identify":
        shutil.copy(samples.moved() / "log.csv", folder)
    (folder / "set.toml").write_text("damping = [0.99, 1.01]\n")
    return folder


@functools.cache
def uninterrupted(name: str) -> tuple[int, Path]:
    """Return how often a command touches the disk, and a folder with what it makes if nothing happens to it."""
    folder = begun(name)
    run = Run(COMMANDS[name], folder, count=True)
    if run.wait() != 0:
        raise Broken(f"{name} ends with {run.process.exitcode}: {run.err[-300:]}")
    return int((folder / "count").read_text()), folder


def check_errors(code: int, err: str) -> None:
    if code not in CODES:
        raise Broken(f"exit code {code}: {err[-300:]!r}")
    if "Traceback" in err or "Error:" in err.split("\n")[-1]:
        raise Broken(f"a traceback: {err[-300:]!r}")
    err = without_progress(err)
    if code == 2 and (err.count("\n") != 1 or not err.strip()):
        raise Broken(f"{err.count(chr(10))} lines on standard error: {err[-300:]!r}")
    if any(ord(one) < 32 and one != "\n" for one in err):
        raise Broken(f"control characters on standard error: {err[-300:]!r}")


def check_whole(folder: Path) -> None:
    """Check every file: whole, by its format. Hidden files are those that were being written when the process died."""
    for path in folder.rglob("*"):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.is_file() and not hidden and path.name not in ("stdout", "stderr", "count"):
            try:
                _check_file(path)
            except Exception as error:
                size = path.stat().st_size
                raise Broken(f"{path.relative_to(folder)} of {size} bytes is not whole: {error!r:.200}") from None


def _check_file(path: Path) -> None:
    data = path.read_bytes()
    match path.suffix:
        case ".json":
            json.loads(data)
        case ".npz" | ".fmu":
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                assert archive.testzip() is None
        case ".png":
            assert data.startswith(b"\x89PNG") and data.endswith(b"IEND\xaeB`\x82")
        case ".svg" | ".html":
            assert data.rstrip().endswith(f"</{path.suffix[1:]}>".encode())
        case ".csv":
            rows = list(csv.reader(io.StringIO(data.decode())))
            assert data.endswith(b"\n") and len({len(row) for row in rows}) == 1
        case ".pt":
            assert data.startswith(b"fuzzyarm-checkpoint")
        case ".toml" | ".c" | ".h" | ".md":
            assert data.endswith(b"\n")
        case ".hdf5":
            import h5py

            h5py.File(io.BytesIO(data)).close()


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def results(folder: Path) -> dict[str, Any]:
    """Return what has to be the same in every run: everything but times and what holds them."""
    found: dict[str, Any] = {}
    for pattern in ("curve.csv", "policy/*", "laws.json", "steps/*.json"):
        found |= {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob(pattern)}
    for path in folder.glob("chunks/*.npz"):
        with np.load(path) as file:  # seconds of the episodes differ from run to run
            found[path.name] = {one: file[one].tobytes() for one in file.files if one != "seconds"}
    return found


def places(count: int, most: int) -> list[int]:
    """Return numbers below `count`: the first, the last, and others evenly between."""
    return sorted({round(k * (count - 1) / max(1, min(most, count) - 1)) for k in range(min(most, count))})


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_stopped_leaves_whole_files_and_goes_on(name):
    """Killed and interrupted in turn, at the first file, at the last and between."""
    count, whole = uninterrupted(name)
    check_whole(whole)
    for turn, at in enumerate(places(count, 2 * max(1, round(float(os.environ.get("ABUSE_TIMES", "1")))))):
        number = (signal.SIGKILL, signal.SIGINT)[turn % 2]
        folder = begun(name)
        run = Run(COMMANDS[name], folder, at=at, signal=number)
        code = run.wait()
        where = f"{number.name} at file {at} of {count}"
        if code not in ((-number,) if number == signal.SIGKILL else (0, 130)):
            raise Broken(f"{where}: exit code {code}: {run.err[-300:]!r}")
        if number == signal.SIGINT:
            check_errors(code, run.err)
            # A folder that is being removed may stay, empty.
            parts = [path for path in folder.rglob("*") if path.is_file()]
            hidden = [one for one in parts if any(part.startswith(".") for part in one.relative_to(folder).parts)]
            assert not hidden, f"{where}: left {hidden}"
        check_whole(folder)
        _go_on(name, folder, whole, where)
        shutil.rmtree(folder)


def _go_on(name: str, folder: Path, whole: Path, where: str) -> None:
    """Run the command again, or go on where it can; the results are those of a run that nothing happened to."""
    run = Run(RESUMED.get(name, COMMANDS[name]), folder)
    code = run.wait()
    if code == 2 and name in RESUMED:  # nothing was begun yet: then it can be begun again
        check_errors(code, run.err)
        run = Run(COMMANDS[name], folder)
        code = run.wait()
    if code == 2 and name == "dataset" and "already exists" in run.err:
        return
    if code != 0:
        raise Broken(f"{where}: going on ends with {code}: {run.err[-300:]!r}")
    missing = {one for one in names(whole / "out") if not one.startswith(".")} - names(folder / "out")
    assert not missing, f"{where}: without {sorted(missing)}"
    expected, found = results(whole / "out"), results(folder / "out")
    assert found == expected, f"{where}: other {[one for one in expected if found.get(one) != expected[one]]}"
    check_whole(folder)


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "dataset"])  # there HDF5 ends the process
def test_a_full_disk_leaves_whole_files_and_no_success(name):
    _, whole = uninterrupted(name)
    folder = begun(name)
    run = Run(COMMANDS[name], folder, largest=FULL)
    check_errors(code := run.wait(), run.err)
    check_whole(folder)
    missing = names(whole / "out") - names(folder / "out")
    assert code != 0 or not missing, f"exit code 0 without {sorted(missing)}"


@pytest.mark.parametrize("name", [*COMMANDS])
def test_two_processes_in_one_folder_make_what_one_makes_or_one_says_so(name):
    _, whole = uninterrupted(name)
    folder = begun(name)
    runs, beside = [Run(COMMANDS[name], folder)], scratch()
    for path in folder.iterdir():
        (beside / path.name).symlink_to(path)
    if not (beside / "out").exists():
        (beside / "out").symlink_to(folder / "out")
        (folder / "out").mkdir(exist_ok=True)
    runs.append(Run(COMMANDS[name], beside))
    codes = [run.wait() for run in runs]
    for code, run in zip(codes, runs, strict=True):
        assert code in (0, 2), f"exit code {code}: {run.err[-300:]!r}"
        check_errors(code, run.err)
    assert 0 in codes
    check_whole(folder)
    assert {one for one in names(whole / "out") if not one.startswith(".")} <= names(folder / "out")
    assert results(folder / "out") == results(whole / "out")
