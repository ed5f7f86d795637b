"""A damaged folder gives one clear line and exit code 2, and an existing page stays."""

import json
import shutil

import pytest
from support.altered_evaluations import wild, with_runs, write

from fuzzyarm.cli import main
from fuzzyarm.eval.evaluation.results_file import read_evaluation

KEPT = "a page made before"


def refusal(folder, capsys):
    """Return the line that `fuzzyarm report` prints, and check that it wrote nothing."""
    page = folder / "report.html"
    page.write_text(KEPT)
    names = {path.name for path in folder.iterdir()}
    assert main(["report", str(folder)]) == 2
    assert page.read_text() == KEPT
    assert {path.name for path in folder.iterdir()} == names
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and "Traceback" not in captured.err
    assert captured.out == ""
    return captured.err


@pytest.fixture
def copy(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy")


def change(folder, **values):
    path = folder / "results.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_what_is_read_is_what_was_evaluated(evaluation, folder):
    stored = read_evaluation(folder)
    assert stored.config == evaluation.config
    assert stored.rows == evaluation.rows
    assert (stored.certificates, stored.bounds) == (evaluation.certificates, evaluation.bounds)


def test_no_folder_and_an_empty_one(tmp_path, capsys):
    assert main(["report", str(tmp_path / "none")]) == 2
    assert "is not a folder; make an evaluation with fuzzyarm evaluate" in capsys.readouterr().err
    assert "holds no results.json; make an evaluation with fuzzyarm evaluate" in refusal(tmp_path, capsys)


@pytest.mark.parametrize("name", ["report.txt", "no/such/report.html"])
def test_a_bad_place_for_the_page(folder, tmp_path, capsys, name):
    assert main(["report", str(folder), "--out", str(tmp_path / name)]) == 2
    assert "must be a file ending in .html" in (err := capsys.readouterr().err) or "does not exist" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content", ["", "{", "[1]", "{}", "null", "[" * 100_000, '{"schema": "fuzzyarm-evaluation/2"}']
)
def test_broken_or_foreign_results(copy, capsys, content):
    (copy / "results.json").write_text(content)
    message = refusal(copy, capsys)
    assert "results.json" in message and ("not a JSON document" in message or "'fuzzyarm-evaluation/1'" in message)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("config", {}),
        ("config", None),
        ("results", []),
        ("results", None),
        ("certificates", {}),
        ("certificates", {"fuzzy-4": 1, "computed-torque": None, "fuzzy-4-tip": None}),
        ("certified_bounds", None),
        ("certified_bounds", {"fuzzy-4": {}, "computed-torque": None, "fuzzy-4-tip": None}),
        ("certified_bounds", {"fuzzy-4": {"alpha": -1, "gamma": 1}, "computed-torque": None, "fuzzy-4-tip": None}),
        ("machine", {}),
        ("rollouts_sha256", 0),
    ],
)
def test_damaged_fields(copy, capsys, key, value):
    change(copy, **{key: value})
    assert "fuzzyarm evaluate --out" in refusal(copy, capsys)


def test_episodes_that_were_not_asked_for(evaluation, tmp_path, capsys):
    made = with_runs(evaluation, evaluation.rollouts)
    folder = write(made, tmp_path / "e")
    document = json.loads((folder / "results.json").read_text())
    change(folder, config=document["config"] | {"cases": ["machining", "nominal"]})
    assert "where the row of ('machining', " in refusal(folder, capsys)
    change(folder, results=sorted(document["results"], key=lambda row: row["case"]))
    assert "other episodes" in refusal(folder, capsys)


def test_an_episode_that_ended_early_is_fine(evaluation, tmp_path):
    runs = [wild(run, "wild", 1) for run in evaluation.rollouts if run.policy == "fuzzy-4"]
    assert main(["report", str(write(with_runs(evaluation, runs), tmp_path / "e"))]) == 0
