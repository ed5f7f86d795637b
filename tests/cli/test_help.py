"""What the command line says of itself: help at 80 columns, groups, completion, and one line for each mistake."""

import contextlib
import functools
import importlib.util
import io
import os
import platform
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
import rich.console

from fuzzyarm import __version__
from fuzzyarm.cli import main
from fuzzyarm.cli.application import GROUPS, command_line
from fuzzyarm.eval.episodes.metrics import columns
from fuzzyarm.eval.evaluation.result_table import print_results, verdict

COMMANDS = [[name] for commands in GROUPS.values() for name in commands] + [["train", "ppo"]]
COMPUTING = [words for words in COMMANDS if words != ["train"]]


def printed(capsys, *words):
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


@functools.cache
def help_at_80_columns(*words):
    """What --help prints; the test sets COLUMNS."""
    assert os.environ["COLUMNS"] == "80"
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main([*words, "--help"]) == 0
    return out.getvalue()


LOADED = """
import sys
from fuzzyarm.cli import main  # noqa: E402
heavy = ("llvmlite", "scipy", "matplotlib", "torch", "ray", "joblib", "clarabel", "flint")
for line in sys.argv[1:]:
    main(line.split())
    print("loaded", [name for name in heavy if name in sys.modules])
"""


def loaded_after(*lines):
    """The heavy libraries that command lines have imported, one line after the other in one process."""
    done = subprocess.run([sys.executable, "-c", LOADED, *lines], capture_output=True, text=True, check=True)
    return [line for line in done.stdout.splitlines() if line.startswith("loaded")]


def test_the_commands_are_shown_in_groups(capsys):
    lines = printed(capsys, "--help").splitlines()
    headings = {heading: next(k for k, line in enumerate(lines) if heading in line) for heading in GROUPS}
    assert sorted(headings.values()) == list(headings.values())
    for heading, commands in GROUPS.items():
        for name, text in commands.items():
            (place,) = [k for k, line in enumerate(lines) if line.startswith(f"│ {name} ")]
            assert place > headings[heading] and text in lines[place]
            assert all(place < other for other in headings.values() if other > headings[heading])


@pytest.mark.parametrize("words", [[], *COMMANDS], ids=" ".join)
def test_help_fits_80_columns(words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    lines = help_at_80_columns(*words).splitlines()
    assert capsys.readouterr().err == ""
    assert lines[0].startswith(" ".join(["Usage: fuzzyarm", *words]))
    assert max(map(len, lines)) <= 80
    assert not any("…" in line for line in lines)


@pytest.fixture(scope="module")
def application():
    """The whole command line."""
    return command_line()


@pytest.mark.parametrize("words", COMPUTING, ids=" ".join)
def test_every_option_has_help_and_a_name_of_its_own(words, application):
    command = application
    for word in words:
        command = command[word]
    arguments = command.assemble_argument_collection(parse_docstring=True)
    assert len(arguments) > 1
    for argument in arguments:
        text = argument.parameter.help
        assert text and len(text) > 10 and (text[0].isupper() or text[0].isdigit()), (argument.name, text)


def test_the_version(capsys):
    first, *others = printed(capsys, "--version").splitlines()
    assert first == f"fuzzyarm {__version__}"
    versions = dict(line.split(" ", maxsplit=1) for line in others)
    assert {"Python", "numpy", "llvmlite", "scipy", "gymnasium", "clarabel", "python-flint", "on"} <= set(versions)
    assert versions["Python"] == platform.python_version() and versions["numpy"] == metadata.version("numpy")
    assert ("torch" in versions) == (importlib.util.find_spec("torch") is not None)


def test_help_loads_nothing_that_computes():
    assert loaded_after("--help", "--version", "evaluate --help", "design --help") == ["loaded []"] * 4


def test_completion_is_installed_and_completes(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    script = tmp_path / "completion"
    assert main(["--install-completion", "--shell", "bash", "--output", str(script)]) == 0
    assert str(script) in capsys.readouterr().out
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")

    def completed(*words):
        line = f'. "{script}"; COMP_WORDS=({" ".join(words)}); COMP_CWORD={len(words) - 1}; _fuzzyarm; '
        command = [shutil.which("bash"), "-c", line + 'echo "${COMPREPLY[@]}"']
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=dict(os.environ))
        return done.stdout.split()

    assert completed("fuzzyarm", "eva") == ["evaluate"]
    assert completed("fuzzyarm", "evaluate", "--enc") == ["--encoder-noise"]
    assert completed("fuzzyarm", "train", "p") == ["ppo"]
    assert "paper" in completed("fuzzyarm", "design", "--theorem", "p")


def row(policy, case, rms, *, seed=0, completed=True, largest=1.0):
    """A row of results; its numbers have as many digits as there can be."""
    metrics = dict.fromkeys((one.name for metrics in columns().values() for one in metrics), -123456.789)
    own = {"tip_error_rms_mm": rms, "tip_error_max_mm": largest}
    return {"case": case, "policy": policy, "seed": seed, "completed": completed, **metrics, **own}


THREE = [
    *(row(name, "nominal", rms) for name, rms in (("a", 1.0), ("b", 0.000419), ("c", 2.0))),
    *(row(name, "machining", rms) for name, rms in (("a", 1.0), ("b", 1.0), ("c", 2.0))),
    *(row(name, "payload", 1.0, completed=False) for name in "abc"),
]


def test_the_verdict_of_three_cases_has_five_lines():
    assert verdict(THREE, {"a": "For the ...", "b": None, "c": None}, Path("my folder"), 43) == [
        "Case 1: nominal: b won, rms tip error < 0.001 mm",
        "Case 2: machining force: a, b tie, rms tip error 1.00 mm",
        "Case 3: 5 kg payload: no policy followed the path to its end",
        "Proven of the rigid arm: a; nothing of 2 others",
        "43 files in 'my folder'; next: fuzzyarm report 'my folder'",
    ]


def test_who_lost_the_path_once_cannot_win():
    rows = [row("a", "nominal", 1e-3, seed=seed, completed=seed != 1) for seed in range(3)]
    rows += [row("far", "nominal", 1e-3, largest=101.0)]
    rows += [row("b", "nominal", rms, seed=seed) for seed, rms in enumerate((5.0, 1.0, 2.0))]
    assert verdict(rows, {"a": None}, Path("x"), 3)[:2] == [
        "Case 1: nominal: b followed, rms tip error 2.00 mm; a, far lost the path",
        "Proven of the rigid arm: nothing",
    ]


@pytest.mark.parametrize(("width", "left_out"), [(200, ()), (80, (6,)), (60, (3, 4, 5, 6)), (34, (1, 3, 4, 5, 6))])
def test_a_narrow_terminal_has_fewer_columns_and_every_digit_of_the_others(width, left_out):
    rows = [row("computed-torque-tip", "nominal", 1234.5, largest=0.0412)]
    screen = rich.console.Console(file=io.StringIO(), force_terminal=True, width=width, color_system=None)
    print_results(rows, screen)
    text = screen.file.getvalue()
    assert max(map(len, text.splitlines())) <= width and "…" not in text
    assert "1.23e+03" in text and "0.0412" in text  # rms and the largest error are always there
    note = " ".join(text.split("Left out on")[1].split()) if left_out else ""
    assert ("Left out on" in text) == bool(left_out)
    for number in left_out:
        assert list(columns())[number] in note
