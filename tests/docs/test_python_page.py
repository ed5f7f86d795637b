"""The page about Python: every command is on it, its names exist, and its lines give the numbers of the commands."""

import ast
import json
import re
import shlex

import numpy as np
import pytest
from support.command_line import printed
from support.documentation import ROOT

import fuzzyarm
from fuzzyarm.cli import main
from fuzzyarm.cli._application import GROUPS
from fuzzyarm.fuzzy_policy.controller import Controller

TEXT = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
PARTS = dict(re.findall(r"^### (\S+)\n(.*?)(?=^##)", TEXT, re.S | re.M))


def code(text):
    return [block for _, block in re.findall(r"```(\{code-cell\}|python)\n(.*?)```", text, re.S)]


def command(name):
    (line,) = re.findall(r"```bash\n(.*?)\n```", PARTS[name])
    return shlex.split(line)[1:]


def test_every_command_stands_on_the_page_and_the_names_are_public():
    assert set(PARTS) == {name for commands in GROUPS.values() for name in commands}
    assert all(command(name)[0] == name and len(code(part)) == 1 for name, part in PARTS.items())
    imported = [node for block in code(TEXT) for node in ast.walk(ast.parse(block)) if isinstance(node, ast.ImportFrom)]
    names = {alias.name for node in imported if node.module == "fuzzyarm" for alias in node.names}
    assert len(names) > 10 and names <= set(fuzzyarm.__all__)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The names of the page after its lines up to `prove`, and the folders of the lines and of the commands."""
    folders = tmp_path_factory.mktemp("lines"), tmp_path_factory.mktemp("commands")
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folders[0])
        for block in code(TEXT[: TEXT.index("### sweep")]):
            exec(compile(block, "python.md", "exec"), names)
        patch.chdir(folders[1])
        for name in ("design", "evaluate", "report", "export", "prove"):
            assert main(command(name)) == 0
    return names, *folders


@pytest.mark.slow
def test_lines_and_commands_write_the_same_files(done):
    names, lines, commands = done
    first, second = (Controller.load(folder / "one.json") for folder in (lines, commands))
    assert np.array_equal(first.gains, second.gains) and np.array_equal(names["made"].controller.gains, first.gains)
    found = (json.loads((folder / "results/results.json").read_text())["results"] for folder in (lines, commands))
    for row, other in zip(*found, strict=True):
        assert {**row, "predict_us": 0} == {**other, "predict_us": 0}
    assert (lines / "results/report.html").is_file() and (commands / "results/report.html").is_file()
    for file in ("one.h", "one.c", "one_vectors.csv"):
        assert (lines / "results" / file).read_text() == (commands / "results" / file).read_text()
    bounds = [json.loads((folder / "bound.json").read_text()) for folder in (lines, commands)]
    assert bounds[0]["bound"] == bounds[1]["bound"] == names["bound"].largest


@pytest.mark.slow
def test_lines_and_commands_print_the_same_numbers(done, monkeypatch, capsys):
    names, lines, commands = done
    monkeypatch.chdir(lines)
    (verified,), sheet, margins = (
        json.loads(printed(capsys, *command(name), "--json")) for name in ("verify", "show", "margins")
    )
    assert verified["margin"] == names["check"].certificate.proof_margin and verified["proven"]
    assert sheet == names["sheet"].to_dict() and margins["rows"] == names["document"]["rows"]
    monkeypatch.chdir(commands)
    assert names["standing"].policy in printed(capsys, *command("leaderboard"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sweep", "train", "bench", "paper"])
def test_what_the_page_does_not_execute_runs_as_well(name, tmp_path, monkeypatch):
    folders, names = [tmp_path / "lines", tmp_path / "commands"], {}
    for folder in folders:
        folder.mkdir()
    monkeypatch.chdir(folders[0])
    exec(compile("\n".join(code(PARTS[name])), "python.md", "exec"), names)
    monkeypatch.chdir(folders[1])
    match name:
        case "paper":
            assert names["comparison"].drifted == []
        case "bench":
            assert names["document"]["rows"]
        case "sweep":
            assert main(command(name)) == 0
            rows, others = (json.loads((folder / "plants/sweep.json").read_text())["rows"] for folder in folders)
            assert rows == others
        case "train":
            assert main(command(name)) == 0
            first, second = ((folder / "training/policy/weights.safetensors").read_bytes() for folder in folders)
            assert first == second
