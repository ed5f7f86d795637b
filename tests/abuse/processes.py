"""Commands in processes of their own: killed, interrupted, on a full disk, with closed streams, without a home."""

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
import time
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .command_line import check_errors
from .samples import SMALL_TRAINING, evaluation, room, scratch
from .surface import Broken, Surface, Try

__all__ = ["EVALUATE", "PATIENCE", "SURFACES", "check_whole", "uninterrupted"]

EVALUATE = ["evaluate", "--policy", "fuzzy-1", "--case", "nominal", "--out", "out"]
SWEEP = [
    "sweep",
    "--policy",
    "fuzzy-1",
    "--case",
    "nominal",
    "--plants",
    "6",
    "--chunk",
    "1",
    "--jobs",
    "1",
    "--out",
    "out",
]
TRAIN = ["train", "ppo", "--out", "out", "--no-tensorboard"]
for _name, _value in SMALL_TRAINING.items():
    if _name != "tensorboard":
        TRAIN += [f"--{_name.replace('_', '-')}", *map(str, _value if isinstance(_value, tuple) else (_value,))]
COMMANDS = {
    "evaluate": EVALUATE,
    "sweep": SWEEP,
    "train": TRAIN,
    "design": ["design", "--rules", "1", "--out", "out/controller.json"],
    "report": ["report", "evaluation", "--out", "out/report.html"],
}
RESUMED = {
    "sweep": ["sweep", "--resume", "--jobs", "1", "--out", "out"],
    "train": ["train", "ppo", "--resume", "--out", "out"],
}
REPORTED = "computed-torque"  # the shortest report
PATIENCE = 1200  # s of wall time; a command takes three
LINE = 1500  # bytes; no line of an error is longer

_Setting = Callable[[], None]


class _Run:
    """A command that runs in a folder, in a process that has the package loaded already."""

    def __init__(self, words: Sequence[str], folder: Path, **streams: Any) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([f"{__package__}.preloaded"])
        self.ready, told = context.Pipe(duplex=False)
        self.process = context.Process(target=_command, args=(list(words), str(folder), told, streams))
        self.process.start()
        told.close()
        self.folder = folder
        self.ready.recv()

    def wait(self) -> int:
        self.process.join(PATIENCE)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()
            raise Broken(f"still running after {PATIENCE} s")
        return self.process.exitcode

    @property
    def err(self) -> str:
        return (self.folder / "stderr").read_text(errors="replace")


def _command(words: list[str], folder: str, told: Any, streams: dict[str, Any]) -> None:
    """Run a command line as the installed program does."""
    os.chdir(folder)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # as Python itself sets it
    out = os.open(streams.get("stdout", "stdout"), os.O_WRONLY | os.O_CREAT)
    err = os.open("stderr", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1), os.dup2(err, 2)
    sys.stdout, sys.stderr = (open(handle, "w", closefd=False) for handle in (1, 2))  # noqa: SIM115
    if "largest" in streams:
        resource.setrlimit(resource.RLIMIT_FSIZE, (streams["largest"], streams["largest"]))
    from fuzzyarm.cli import main

    try:
        told.send("ready")
        code = main(words)
        sys.stdout.flush()
    except KeyboardInterrupt:  # outside the command
        code = 130
    except OSError:  # the last flush, as at the end of Python
        code = 120
    with contextlib.suppress(OSError):
        sys.stderr.flush()
    os._exit(code)


def _begun(name: str) -> Path:
    uninterrupted(name)
    folder = scratch()
    (folder / "out").mkdir()
    if name in ("sweep", "train"):
        (folder / "out").rmdir()
    if name == "report":
        shutil.copytree(evaluation(REPORTED), folder / "evaluation")
    return folder


def check_whole(folder: Path) -> None:
    """Check every file: whole, by its format. Hidden files are those that were being written when the process died."""
    for path in folder.rglob("*"):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.is_file() and not hidden and path.name not in ("stdout", "stderr"):
            try:
                _check_file(path)
            except Exception as error:
                raise Broken(
                    f"{path.relative_to(folder)} of {path.stat().st_size} bytes is not whole: {error!r:.200}"
                ) from None


def _check_file(path: Path) -> None:
    data = path.read_bytes()
    match path.suffix:
        case ".json":
            json.loads(data)
        case ".npz":
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                assert archive.testzip() is None
        case ".png":
            assert data.startswith(b"\x89PNG") and data.endswith(b"IEND\xaeB`\x82")
        case ".svg":
            assert data.rstrip().endswith(b"</svg>")
        case ".html":
            assert data.rstrip().endswith(b"</html>")
        case ".csv":
            rows = list(csv.reader(io.StringIO(data.decode())))
            assert data.endswith(b"\n") and len({len(row) for row in rows}) == 1
        case ".pt":
            assert data.startswith(b"fuzzyarm-checkpoint")


def _whole_folder(name: str) -> Path:
    """Where `uninterrupted` lets a command work."""
    return room() / f"whole-{name}" / "out"


def _names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@functools.cache
def uninterrupted(name: str) -> tuple[float, dict[str, bytes]]:
    """Return how long a command takes [s], and what it makes, if nothing happens to it."""
    evaluation(REPORTED)
    folder = _whole_folder(name).parent
    (folder / "out").mkdir(parents=True)
    if name in ("sweep", "train"):
        (folder / "out").rmdir()
    if name == "report":
        shutil.copytree(evaluation(REPORTED), folder / "evaluation")
    begin = time.monotonic()
    run = _Run(COMMANDS[name], folder)
    code = run.wait()
    if code != 0:
        raise Broken(f"{name} ends with {code}: {run.err[-300:]}")
    return time.monotonic() - begin, _results(folder / "out")


def _results(folder: Path) -> dict[str, bytes]:
    """Return what has to be the same in every run: everything but times and what holds them."""
    names = ("chunks/*.npz", "sweep.csv", "curve.csv", "policy/*")
    return {str(path.relative_to(folder)): path.read_bytes() for name in names for path in sorted(folder.glob(name))}


def _stopped(number: signal.Signals, name: str) -> Callable[[np.random.Generator], Try]:
    """Tries of a signal at a random moment."""

    def attempt(rng: np.random.Generator) -> Try:
        share = float(rng.uniform(0.0, 1.1))

        def run() -> None:
            seconds, whole = uninterrupted(name)
            folder = _begun(name)
            command = _Run(COMMANDS[name], folder)
            time.sleep(share * seconds)
            if command.process.pid is not None and command.process.is_alive():
                os.kill(command.process.pid, number)
            code = command.wait()
            if code not in (0, -number, *((130,) if number == signal.SIGINT else ())):
                raise Broken(f"exit code {code}: {command.err[-300:]!r}")
            if number == signal.SIGINT:
                check_errors(code, command.err)
            check_whole(folder)
            _go_on(name, folder, whole)

        return Try(f"{number.name} after {share:.3f} of fuzzyarm {name}", run)

    return attempt


def _go_on(name: str, folder: Path, whole: dict[str, bytes]) -> None:
    """Run the command again, or go on where it can; the results are those of a run that nothing happened to."""
    if name not in RESUMED:
        return
    command = _Run(RESUMED[name], folder)
    code = command.wait()
    if code == 2:  # nothing was begun yet: then it can be begun anew
        check_errors(code, command.err)
        command = _Run(COMMANDS[name], folder)
        code = command.wait()
    if code != 0:
        raise Broken(f"going on ends with {code}: {command.err[-300:]!r}")
    found = _results(folder / "out")
    if name == "sweep":  # seconds of the episodes differ from run to run
        found, whole = ({one: _numbers(data) for one, data in results.items()} for results in (found, whole))
    if found != whole:
        raise Broken(f"other results after going on: {[one for one in whole if found.get(one) != whole[one]]}")


def _numbers(data: bytes) -> Any:
    if not data.startswith(b"PK"):
        return None
    with np.load(io.BytesIO(data)) as file:
        return {one: file[one].tobytes() for one in file.files if one != "seconds"}


def _full_disk(rng: np.random.Generator) -> Try:
    name = list(COMMANDS)[rng.integers(len(COMMANDS))]
    largest = int(10.0 ** rng.uniform(0.0, 6.0))

    def run() -> None:
        folder = _begun(name)
        command = _Run(COMMANDS[name], folder, largest=largest)
        code = command.wait()
        check_errors(code, command.err, f", files up to {largest} bytes", heard=largest > LINE)
        check_whole(folder)
        missing = _names(_whole_folder(name)) - _names(folder / "out")
        if code == 0 and missing:
            raise Broken(f"exit code 0 without {sorted(missing)}, files up to {largest} bytes")

    return Try(f"fuzzyarm {name} where files may have {largest} bytes", run)


SURFACES = (
    *(
        Surface(
            f"{text} of {name}",
            "processes",
            12,
            _stopped(number, name),
            prepare=functools.partial(uninterrupted, name),
        )
        for text, number in (("kill -9", signal.SIGKILL), ("SIGINT", signal.SIGINT))
        for name in COMMANDS
    ),
    Surface("full disk", "processes", 30, _full_disk, prepare=lambda: [uninterrupted(name) for name in COMMANDS]),
)
