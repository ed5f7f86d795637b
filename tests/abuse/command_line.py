"""Every option of the command line: wrong, missing, repeated, huge, in all scripts, with control characters.

The words go through the whole command up to where it would begin to compute, which is stubbed: a valid command line is
none of the tries' business.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from fuzzyarm.cli import main
from fuzzyarm.cli.application import GROUPS
from fuzzyarm.cli.options import option_name
from fuzzyarm.cli.train import options_of
from fuzzyarm.rl_baselines.algorithms import ALGORITHMS

from .damage import SPECIAL
from .documents import CONTROLLERS, no_code_ran
from .samples import evaluation, scratch
from .surface import Broken, Surface, Try
from .values import hostile_text

__all__ = ["CODES", "SURFACES", "check_errors", "options"]

CODES = (0, 1, 2, 130, 141)
COMPUTING = (
    "fuzzyarm.eval.evaluation.run.evaluate",
    "fuzzyarm.eval.evaluation.recheck.recheck_results",
    "fuzzyarm.eval.sweep.run.Sweep.begin",
    "fuzzyarm.rl_baselines.progress.train_with_progress",
    "fuzzyarm.synthesis.design",
    "fuzzyarm.synthesis.design_scheduled",
    "fuzzyarm.eval.certified.tip.bound.find_bound",
    "fuzzyarm.eval.certified.tip.cells.bounds_of_cells",
    "fuzzyarm.eval.dataset.store.write_dataset",
    "fuzzyarm.eval.bench.run.run_bench",
    "fuzzyarm.eval.stability.margins.measure_margins",
    "fuzzyarm.eval.paper.evidence.gather",
    "fuzzyarm.eval.report.page.write_report",
    "fuzzyarm.eval.tuning.run.tune",
    "fuzzyarm.export.laws.sheet_of",
    "fuzzyarm.export.c_files.export_c",
    "fuzzyarm.export.fmu.export_controller_fmu",
    "fuzzyarm.export.fmu.export_plant_fmu",
    "fuzzyarm.identification.excitation.suggested",
    "fuzzyarm.identification.result.identify",
)
"""Where commands begin to compute."""
NUMBERS = (
    "0",
    "-1",
    "1",
    "2",
    "3.5",
    "1e3",
    "1e400",
    "nan",
    "inf",
    "-inf",
    "0x10",
    "1_000",
    "9" * 400,
    "1e-400",
    "5e-324",
    "١",
)
NEEDED = {
    "verify": [str(CONTROLLERS / "fuzzy-1.json")],
    "design": ["--out", "controller.json", "--rules", "1"],
    "tune": ["--out", "my-arm"],
    "paper": ["--out", "paper"],
    "prove": ["--policy", "fuzzy-1", "--out", "bound.json"],
    "leaderboard": ["{evaluation}"],
    "report": ["{evaluation}"],
    "train": ["ppo", "--out", "training"],
    "dataset": ["--out", "sets", "--episodes", "3"],
    "evaluate": ["--policy", "fuzzy-1", "--case", "nominal"],
    "margins": ["--policy", "fuzzy-1"],
    "sweep": ["--policy", "fuzzy-1", "--plants", "4", "--jobs", "1"],
    "bench": ["--rounds", "5"],
    "show": ["fuzzy-1"],
    "identify": ["--suggest", "motion.csv"],
    "export": ["c", "fuzzy-1", "--out", "source"],
}
"""A valid command line of each command, behind its name."""


class _Computes(BaseException):
    """The command line was accepted."""


class _Refused(ValueError):
    """Exit code 2 with one line."""


def options(command: str) -> list[str]:
    """Return the options of a command, with the dashes."""
    if command == "train":
        fields = dataclasses.fields(options_of(ALGORITHMS["ppo"]))
    else:
        fields = dataclasses.fields(importlib.import_module(f"fuzzyarm.cli.{command}").Options)
    return [
        f"--{option_name(field.name)}" for field in fields if field.name not in ("files", "folder", "what", "_")
    ] + ["--help"]


def _words(rng: np.random.Generator, command: str) -> list[str]:
    """A valid command line with one to three pieces of nonsense."""
    words = [str(evaluation()) if word == "{evaluation}" else word for word in NEEDED[command]]
    for _ in range(int(rng.choice([1, 1, 2, 3]))):
        _spoil(rng, words, options(command))
    return words


def _spoil(rng: np.random.Generator, words: list[str], names: list[str]) -> None:
    option, change = names[rng.integers(len(names))], rng.integers(9)
    place = int(rng.integers(len(words) + 1))
    if change <= 3:
        words += [option, *(_value(rng) for _ in range(int(rng.choice([0, 1, 1, 1, 2, 3, 4]))))]
    elif change == 4:
        words.append(f"{option}={_value(rng)}")
    elif change == 5 and words:
        words[min(place, len(words) - 1)] = _value(rng)
    elif change == 6 and words:
        del words[min(place, len(words) - 1)]
    elif change == 7:
        words[place:place] = [_value(rng)]
    else:
        words += [option, _value(rng)] * int(rng.choice([2, 3, 200]))


def _value(rng: np.random.Generator) -> str:
    kind = rng.random()
    if kind < 0.4:
        return hostile_text(rng).replace("\x00", "")  # no word can hold it
    if kind < 0.7:
        return NUMBERS[rng.integers(len(NUMBERS))]
    names = (
        "mass",
        "payload",
        "delay",
        "nominal",
        "machining",
        "fuzzy-1",
        "robust",
        "loads",
        "max",
        "min",
        "paper",
        "ppo",
        "z1,z3",
        "local",
    )
    return (
        names[rng.integers(len(names))]
        if kind < 0.9
        else f"special/{list(SPECIAL)[rng.integers(len(SPECIAL))].replace('/', '_')}"
    )


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """Work in a folder, with what may stand in place of a file beside it."""
    here = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(here)


def _specials() -> None:
    folder = Path("special")
    folder.mkdir()
    for name in (
        "a FIFO",
        "a folder",
        "a link to /dev/zero",
        "a link to itself",
        "nothing",
        "an empty file",
        "a key twice",
        "a pickle",
    ):
        SPECIAL[name](folder / name.replace("/", "_"))


def check_errors(code: int, err: str, what: str = "", *, heard: bool = True) -> None:
    """Check an exit code and what was written to standard error; not `heard`: it is closed or full itself."""
    if code not in CODES:
        raise Broken(f"exit code {code}: {err[-300:]!r}{what}")
    if "Traceback" in err or "Error:" in err.split("\n")[-1]:
        raise Broken(f"a traceback: {err[-300:]!r}{what}")
    if heard and code == 2 and (err.count("\n") != 1 or not err.strip()):
        raise Broken(f"{err.count(chr(10))} lines on standard error: {err[-300:]!r}{what}")
    if any(ord(one) < 32 and one != "\n" for one in err):
        raise Broken(f"control characters on standard error: {err[-300:]!r}{what}")


def _attempt(command: str) -> Any:
    def make(rng: np.random.Generator) -> Try:
        words = [command, *_words(rng, command)]

        def run() -> None:
            folder = scratch()
            out, err = _stream("strict"), _stream("backslashreplace")
            with contextlib.ExitStack() as stack:
                stack.enter_context(_inside(folder))
                _specials()
                before = _contents(folder)
                for name in COMPUTING:
                    stack.enter_context(mock.patch(name, side_effect=_Computes))
                stack.enter_context(contextlib.redirect_stdout(out))
                stack.enter_context(contextlib.redirect_stderr(err))
                try:
                    code = main(words)
                except _Computes:
                    return
                except BrokenPipeError:
                    raise
                finally:
                    path = str(folder)
                    while path in sys.path:
                        sys.path.remove(path)
            out.flush(), err.flush()
            no_code_ran()
            check_errors(code, err.buffer.getvalue().decode())  # type: ignore[attr-defined]
            if code == 2 and _contents(folder) != before:
                raise Broken(f"refused, but left {sorted(_contents(folder) - before)}")
            if code == 2:
                raise _Refused

        return Try(" ".join(words)[:300], run)

    return make


def _contents(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def _stream(errors: str) -> io.TextIOWrapper:
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors=errors)


SURFACES = tuple(
    Surface(
        f"fuzzyarm {command}",
        "command line",
        300 if command in ("verify", "report") else 400,
        _attempt(command),
        raises=(_Refused,),
        prepare=evaluation,
    )
    for commands in GROUPS.values()
    for command in commands
)
