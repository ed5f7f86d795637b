"""Every option of the command line: wrong, missing, repeated, huge, in all scripts, with control characters.

The words go through the whole command up to where it would begin to compute, which is stubbed: a valid command line is
none of the tries' business.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import shutil
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzyarm.cli import main
from fuzzyarm.cli.application import GROUPS
from fuzzyarm.cli.options import option_name
from fuzzyarm.cli.train import options_of
from fuzzyarm.rl_baselines.algorithms import ALGORITHMS

from . import samples
from .judged import Broken, examples, held
from .samples import CONTROLLERS, no_code_ran, scratch
from .test_processes import check_errors
from .test_readers import SPECIAL
from .values import hostile

pytestmark = pytest.mark.slow

COMPUTING = (
    "fuzzyarm.eval.evaluation.run.evaluate",
    "fuzzyarm.eval.evaluation.recheck.recheck_results",
    "fuzzyarm.eval.sweep.run.Sweep.begin",
    "fuzzyarm.cli.train.train_with_progress",
    "fuzzyarm.synthesis.design",
    "fuzzyarm.synthesis.design_scheduled",
    "fuzzyarm.policies.tip_bound.find_bound",
    "fuzzyarm.policies.tip_cells.bounds_of_cells",
    "fuzzyarm.eval.dataset.store.write_dataset",
    "fuzzyarm.eval.bench.run.run_bench",
    "fuzzyarm.eval.stability.margins.measure_margins",
    "fuzzyarm.eval.score.scores",
    "fuzzyarm.eval.paper.evidence.gather",
    "fuzzyarm.eval.report.page.write_report",
    "fuzzyarm.eval.tuning.run.tune",
    "fuzzyarm.export.sheet.sheet_of",
    "fuzzyarm.export.c_files.export_c",
    "fuzzyarm.export.fmu.export_controller_fmu",
    "fuzzyarm.export.fmu.export_plant_fmu",
    "fuzzyarm.identification.excitation.suggested",
    "fuzzyarm.identification.result.identify",
)
"""Where commands begin to compute."""
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
    "score": ["--policy", "fuzzy-1"],
    "sweep": ["--policy", "fuzzy-1", "--plants", "4", "--jobs", "1"],
    "bench": ["--rounds", "5"],
    "show": ["fuzzy-1"],
    "identify": ["--suggest", "motion.csv"],
    "export": ["c", "fuzzy-1", "--out", "source"],
}
"""A valid command line of each command, behind its name."""


NUMBERS = ["0", "-1", "1", "2", "3.5", "1e3", "1e400", "nan", "inf", "-inf", "0x10", "1_000", "5e-324", "١", "9" * 400]
NAMES = ["mass", "payload", "delay", "nominal", "machining", "fuzzy-1", "robust", "max", "paper", "ppo", "z1,z3"]
PLACES = tuple(name for name in SPECIAL if len(name) < 20 and name != "a socket")
words = st.one_of(
    hostile.filter(lambda text: "\x00" not in text and len(text) < 100_000),  # no word can hold it
    st.sampled_from(NUMBERS),
    st.sampled_from(NAMES),
    st.sampled_from(PLACES).map(lambda name: f"special/{name.replace('/', '_')}"),
)


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


@st.composite
def command_line(draw: Any, command: str) -> list[str]:
    """A valid command line with one to three pieces of nonsense."""
    line = [str(samples.evaluated()) if word == "{evaluation}" else word for word in NEEDED[command]]
    names = options(command)
    for _ in range(draw(st.integers(1, 3))):
        option, place = draw(st.sampled_from(names)), draw(st.integers(0, len(line)))
        match draw(st.integers(0, 8)):
            case 0 | 1 | 2 | 3:
                line += [option, *draw(st.lists(words, max_size=4))]
            case 4:
                line.append(f"{option}={draw(words)}")
            case 5 if line:
                line[min(place, len(line) - 1)] = draw(words)
            case 6 if line:
                del line[min(place, len(line) - 1)]
            case 7:
                line[place:place] = [draw(words)]
            case _:
                line += [option, draw(words)] * draw(st.sampled_from([2, 3, 200]))
    return [command, *line]


@pytest.mark.parametrize("command", [command for commands in GROUPS.values() for command in commands])
def test_nonsense_is_one_line_and_leaves_nothing(command):
    assert command in NEEDED

    @examples(25)
    @given(line=command_line(command))
    def attempt(line):
        folder = scratch()
        try:
            held(lambda: _refused(line, folder), raises=(_Refused, _Computes))
        except Broken as error:
            raise Broken(f"fuzzyarm {' '.join(line)[:300]}: {error}") from None
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        no_code_ran()

    attempt()


def _refused(line: list[str], folder: Path) -> None:
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors=how) for how in ("strict", "backslashreplace"))
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.chdir(folder))
        (folder / "special").mkdir()
        for name in PLACES:
            SPECIAL[name](folder / "special" / name.replace("/", "_"))
        before = _contents(folder)
        for name in COMPUTING:
            stack.enter_context(mock.patch(name, side_effect=_Computes))
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        try:
            code = main(line)
        finally:
            while str(folder) in sys.path:
                sys.path.remove(str(folder))
    out.flush(), err.flush()
    check_errors(code, err.buffer.getvalue().decode())  # type: ignore[attr-defined]
    if code == 2 and _contents(folder) != before:
        raise Broken(f"refused, but left {sorted(_contents(folder) - before)}")
    if code == 2:
        raise _Refused


def _contents(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}
