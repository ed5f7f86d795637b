"""Every command with closed, full and narrow standard streams: whole files, one line, an exit code that says so."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

import pytest
from slow_twins import slow_but
from support.command_line import printed, refused
from support.shipped import CONTROLLERS

from fuzzyarm.cli import main
from fuzzyarm.cli._application import GROUPS

CONTROLLER = str(CONTROLLERS["paper-1-common"])
NAMES = [name for commands in GROUPS.values() for name in commands]
HELP = [["--help"], ["--version"], *([name, "--help"] for name in NAMES), ["train", "ppo", "--help"]]
BRIEF = ["--n-steps", "32", "--batch-size", "64", "--hidden", "4"]
RUNS = {
    "leaderboard": ["leaderboard", "evaluated"],
    "leaderboard as Markdown": ["leaderboard", "evaluated", "--markdown"],
    "verify": ["verify", CONTROLLER],
    "verify as JSON": ["verify", "--json", CONTROLLER],
    "check": ["evaluate", "--check", "evaluated"],
    "evaluate": ["evaluate", "--policy", "fuzzy-4", "--case", "nominal", "--out", "new"],
    "evaluate as JSON": ["evaluate", "--policy", "fuzzy-4", "--case", "nominal", "--json", "--out", "new"],
    "design": ["design", "--rules", "1", "--no-integral", "--out", "c.json"],
    "linearise": ["linearise", "fuzzy-1", "--out", "loop"],
    "margins": ["margins", "--policy", "fuzzy-1", "--out", "m.json"],
    "sweep": ["sweep", "--policy", "fuzzy-1", "--case", "nominal", "--plants", "2", "--jobs", "1", "--out", "new"],
    "report": ["report", "evaluated"],
    "train": ["train", "ppo", "--out", "new", "--total-timesteps", "64", "--lanes", "2", *BRIEF],
    "paper": ["paper", "--out", "new"],
    "bench": ["bench", "--seconds", "1e-4", "--json"],
}
EVERY_RUN = [pytest.param(words, id=name, marks=pytest.mark.slow) for name, words in RUNS.items()]
BAD = [["fly"]]


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """A folder with a small evaluation."""
    folder = tmp_path_factory.mktemp("streams") / "evaluated"
    with mock.patch("fuzzyarm.eval.evaluation.figures.write_figures", return_value=[]):
        assert main(["evaluate", "--policy", "fuzzy-4", "--case", "nominal", "--json", "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def folder(tmp_path, evaluated):
    """A current folder in which ``evaluated`` is an evaluation."""
    (tmp_path / "evaluated").symlink_to(evaluated)
    return tmp_path


def shell(folder, words, redirected=""):
    """Run the command in a shell with redirections; return the exit code, and standard output and error as bytes."""
    command = ["bash", "-c", f'exec "$0" -m fuzzyarm "$@" {redirected}', sys.executable, *words]
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **os.environ}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("words", [*slow_but(HELP[:1], HELP[:3]), *EVERY_RUN])
def test_a_closed_standard_output_is_refused_before_anything_is_done(folder, words):
    before = set(folder.iterdir())
    code, _, err = shell(folder, words, ">&-")
    assert (code, err) == (2, b"fuzzyarm: standard output is closed; send it to a file, or to /dev/null\n")
    assert set(folder.iterdir()) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("words", [*slow_but(HELP[-1:], [HELP[0], HELP[-1]]), *EVERY_RUN])
def test_a_full_standard_output_is_one_line_and_no_success(folder, words):
    code, _, err = shell(folder, words, ">/dev/full")
    name = " ".join(["fuzzyarm", *(words[:1] if words[0] in NAMES else [])])
    assert code == 2 and err.decode().splitlines()[-1] == f"{name}: standard output: No space left on device"
    assert b"Traceback" not in err and b"Exception" not in err


@pytest.mark.parametrize("words", slow_but(BAD, [*BAD, RUNS["leaderboard"]]))
def test_without_standard_error_the_exit_code_and_the_output_are_the_same(folder, words):
    code, out, _ = shell(folder, words)
    for redirected in ("2>/dev/full", "<&- 2>&-", "2>&-")[: 1 if words in BAD else 3]:
        assert shell(folder, words, redirected)[:2] == (code, out), redirected


@pytest.mark.slow
@pytest.mark.parametrize("closed", ["<&- 2>&-", "2>&-"])
def test_a_file_never_gets_the_number_of_a_closed_stream(folder, closed):
    code, _, _ = shell(folder, ["report", "evaluated", "--out", "page.html"], closed)
    assert code == 0 and (folder / "page.html").read_bytes().startswith(b"<!doctype html>")


HOSTILE = "\x1b[31mred\x1b[0m\x07\x9b2J\u202e.json"


@pytest.mark.parametrize(
    "words",
    [
        ["verify", HOSTILE],
        ["evaluate", "--policy", HOSTILE],
        ["evaluate", "--case", HOSTILE],
        ["evaluate", "--robot", HOSTILE],
        ["leaderboard", HOSTILE],
        ["design", "--out", HOSTILE + "/x.json"],
        ["sweep", "--resume", "--out", HOSTILE],
        ["paper", "--out", "x", "--expected", HOSTILE],
        [HOSTILE],
    ],
    ids=lambda words: " ".join(words[:2]) if words[0] != HOSTILE else "a command",
)
def test_nothing_that_a_terminal_obeys_reaches_it(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    assert refused(capsys, *words)[:-1].isprintable()


def test_a_name_that_exists_is_escaped_too(tmp_path, capsys):
    path = tmp_path / "\x1b[31m\nfuzzy-4.json: PROVEN.json"
    path.write_bytes(Path(CONTROLLER).read_bytes())
    out = printed(capsys, "verify", path)
    assert "\x1b" not in out and r"\x1b[31m\nfuzzy-4.json: PROVEN.json: PROVEN" in out
    error = refused(capsys, "evaluate", "--policy", path, "--out", tmp_path / "out")
    assert "cannot be printed; rename the file" in error


def test_what_is_printed_as_json_is_json_in_ascii(tmp_path, monkeypatch):
    path, out = tmp_path / "γ.json", io.BytesIO()
    path.write_bytes(Path(CONTROLLER).read_bytes())
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(out, "ascii"))
    assert main(["verify", "--json", str(path)]) == 0
    (report,) = json.loads(out.getvalue())
    assert report["proven"] and report["file"] == str(path)
