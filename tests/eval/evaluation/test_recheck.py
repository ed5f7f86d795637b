"""Running an evaluation again from its results: what agrees, what differs, and what is refused."""

import copy
import json
import shutil
import sys
from pathlib import Path

import pytest
from support.command_line import printed, refused
from support.shipped import CONTROLLERS

from fuzzyarm.cli import main
from fuzzyarm.eval.evaluation.recheck import recheck_results
from fuzzyarm.eval.evaluation.results_file import read_results
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, write_results

ROOT = Path(__file__).parents[3]
CHECK = ["evaluate", "--check"]
LAW = "from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy as Law\n"


@pytest.fixture(scope="module")
def evaluation():
    policies, noise = ("fuzzy-4", "computed-torque"), (1e-5, 1e-3)
    return evaluate(EvaluationConfig(policies=policies, cases=("nominal",), seeds=2, encoder_noise=noise))


@pytest.fixture
def document(evaluation):
    return json.loads(json.dumps(evaluation.to_dict()))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    return tmp_path


def write(folder, document):
    path = folder / "results.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")
    return path


def differences(folder, document, evaluation, monkeypatch):
    """What a check of a document finds if this evaluation comes out."""
    monkeypatch.setattr("fuzzyarm.eval.evaluation.recheck.evaluate", lambda *_: evaluation)
    return [found.name for found in recheck_results(read_results(write(folder, document))).differences]


def test_a_fresh_evaluation_agrees_with_itself_and_nothing_is_written(folder, document, capsys):
    path = write(folder, document)
    before = path.read_bytes()
    out = printed(capsys, *CHECK, "results.json")
    numbers = 4 * (len(document["results"][0]) - len(("case", "policy", "seed", "completed", "reason", "predict_us")))
    assert out == f"{numbers + len(('alpha', 'gamma'))} numbers agree (rows: 4)\n"
    assert list(folder.iterdir()) == [path] and path.read_bytes() == before


def test_each_number_is_compared(folder, document, evaluation, monkeypatch):
    """Twice the tolerance is seen, half of it is not; the clock is not compared."""
    names = [k for k, v in document["results"][0].items() if isinstance(v, float) and k != "predict_us"]
    assert len(names) == 16
    document["results"][0]["predict_us"] *= 3.0
    for name in names:
        for factor, expected in ((1.0 + 2e-6, [name]), (1.0 - 5e-7, [])):
            changed = copy.deepcopy(document)
            changed["results"][3][name] *= factor
            assert differences(folder, changed, evaluation, monkeypatch) == expected


def replace(document, keys, value):
    """Put a value into a nested document; instead of `...`, take the key out of it."""
    for key in keys[:-1]:
        document = document[key]
    document[keys[-1]] = value
    if value is ...:
        del document[keys[-1]]


@pytest.mark.parametrize(
    ("keys", "value", "expected"),
    [
        (["results", 1, "completed"], False, ["completed"]),
        (["results", 1, "reason"], "gone", ["reason"]),
        (["results", 1, "energy"], ..., ["energy"]),
        (["results", 1, "height"], 1.0, ["height"]),
        (["certified_bounds", "fuzzy-4", "gamma"], 1e-4, ["gamma"]),
        (["certified_bounds", "fuzzy-4"], None, ["form", "alpha", "gamma", "controller_digest"]),
    ],
)
def test_what_is_no_metric_is_compared_too(folder, document, evaluation, monkeypatch, keys, value, expected):
    replace(document, keys, value)
    assert differences(folder, document, evaluation, monkeypatch) == expected


def test_what_differs_is_shown_with_both_values(folder, document, capsys, evaluation, monkeypatch):
    monkeypatch.setattr("fuzzyarm.eval.evaluation.recheck.evaluate", lambda *_: evaluation)
    document["results"][0]["energy"] = 100.0
    document["results"][3]["return"] = 1.0
    assert main(["evaluate", "--check", str(write(folder, document))]) == 1
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[1][:6] == ["fuzzy-4,", "nominal,", "seed", "0", "energy", "100"]
    assert lines[2][:6] == ["computed-torque,", "nominal,", "seed", "1", "return", "1"]
    assert lines[3] == ["2", "values", "differ", "(rows:", "4)"]


def test_another_file_of_the_same_name_is_noticed(folder, capsys, short):
    mine = folder / "mine.json"
    shutil.copy(CONTROLLERS["fuzzy-1"], mine)
    write_results(evaluate(EvaluationConfig(policies=("mine.json-tip",), cases=("nominal",))), folder)
    printed(capsys, *CHECK, "results.json")
    shutil.copy(CONTROLLERS["fuzzy-2"], mine)
    changed = "mine.json-tip has changed since it was measured: the SHA-256 of mine.json differs"
    assert changed in refused(capsys, *CHECK, "results.json")
    mine.unlink()
    gone = "mine.json-tip is neither in the current folder nor beside the results"
    assert gone in refused(capsys, *CHECK, "results.json")


@pytest.mark.slow
def test_results_hold_no_absolute_path_and_the_file_is_found_again(folder, capsys, undrawn):
    elsewhere, out = folder / "elsewhere", folder / "out"
    elsewhere.mkdir()
    mine = elsewhere / "mine.json"
    shutil.copy(CONTROLLERS["fuzzy-1"], mine)
    learned = shutil.copytree(ROOT / "fuzzyarm/fuzzy_policy/laws/learned/policies/ppo-nominal", elsewhere / "taught")
    names = [f"{mine}-tip", str(learned), "elsewhere/mine.json"]
    arguments = [word for name in names for word in ("--policy", name)]
    assert main(["evaluate", *arguments, "--case", "nominal", "--out", str(out)]) == 0
    text = (out / "results.json").read_text()
    assert str(folder) not in text + (out / "results.csv").read_text() + capsys.readouterr().err
    assert json.loads(text)["config"]["policies"] == ["mine.json-tip", "taught", "elsewhere/mine.json"]
    assert "--policy mine.json-tip --policy taught --policy elsewhere/mine.json" in json.loads(text)["command"]
    printed(capsys, "report", out)
    assert str(folder) not in (out / "report.html").read_text(encoding="utf-8")
    check = [*CHECK, out]
    assert "add --policy PATH/mine.json-tip" in refused(capsys, *check)
    printed(capsys, *check, "--policy", names[0], names[1])
    shutil.copy(mine, out)
    shutil.copytree(learned, out / "taught")
    printed(capsys, *check)
    error = refused(capsys, *check, "--policy", elsewhere / "other.json")
    assert "or gives the new path of a policy's file" in error


def test_a_file_alone_runs_no_code(folder, capsys, short):
    """Only with the same --policy on the command line; then the source must be the one that was measured."""
    source, name = folder / "my_checked.py", "my_checked:Law"
    source.write_text(LAW)
    write_results(evaluate(EvaluationConfig(policies=(name, "computed-torque"), cases=("nominal",))), folder)
    del sys.modules["my_checked"]
    check = [*CHECK, "results.json"]
    assert f"if you trust this code, add --policy {name}" in refused(capsys, *check)
    error = refused(capsys, *check, "--policy", name, "--policy", "my_checked:Other")
    assert "--policy my_checked:Other: with --check, --policy only permits code" in error
    assert "my_checked" not in sys.modules
    assert "numbers agree" in printed(capsys, *check, "--policy", name)
    source.write_text(LAW + "# changed\n")
    changed = f"policy {name} has changed since it was measured: the SHA-256 of my_checked.py"
    assert changed in refused(capsys, *check, "--policy", name)
    del sys.modules["my_checked"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *((words, f"leave out {words[0]}") for words in (["--case", "nominal"], ["--robot", "arm.toml"], ["--json"])),
        (["--seeds", "0"], "leave out --seeds"),
        (["--policy", "fuzzy-4"], "--policy fuzzy-4: with --check"),
    ],
)
def test_options_that_the_file_decides_are_refused(folder, document, capsys, options, message):
    assert message in refused(capsys, *CHECK, write(folder, document), *options)


BROKEN = {
    "another schema": (["schema"], "fuzzyarm-margins/1", "the schema is 'fuzzyarm-margins/1'"),
    "no configuration": (["config"], ..., "missing required field `config`"),
    "no version": (["versions", "fuzzyarm"], ..., "'fuzzyarm' is missing"),
    "a bound": (["certified_bounds", "fuzzy-4", "gamma"], 10**400, "is damaged"),
    "no certificates": (["certificates"], {}, "'fuzzy-4' is missing"),
    "a policy": (["config", "policies", 0], 4, "got `int` at `config.policies[0]`"),
    "a case": (["config", "cases"], ["nowhere"], "choose from: nominal"),
    "many seeds": (["config", "seeds"], 10**12, "its number of rows is 4; needed: "),
    "noise": (["config", "encoder_noise"], [-1.0, 0.0], "EncoderNoise.position = -1.0"),
    "the arm": (["config", "parameters", "mass"], [-1.0, 1.0], "mass[0] = "),
    "an unknown key of the arm": (["config", "parameters", "colour"], "red", "unknown field colour"),
    "a row of another": (["results", 0, "seed"], 1, "instead of ('nominal', 'fuzzy-4', 0)"),
    "no error": (["results", 0, "tip_error_rms_mm"], ..., "a row of its results lacks tip_error_rms_mm"),
    "a word": (["results", 0, "energy"], "much", "energy of ('nominal', 'fuzzy-4', 0) = 'much'"),
    "infinity": (["results", 0, "energy"], float("inf"), "Infinity is not a JSON number"),
    "completed": (["results", 0, "completed"], "yes", "completed = 'yes'"),
}


@pytest.mark.parametrize(("keys", "value", "expected"), BROKEN.values(), ids=BROKEN)
def test_a_broken_file_is_one_line_that_names_it(folder, document, capsys, monkeypatch, keys, value, expected):
    monkeypatch.setattr("fuzzyarm.eval.evaluation.recheck.evaluate", None)  # nothing may run
    replace(document, keys, value)
    path = write(folder, document)
    for command in (CHECK, ["leaderboard"]):
        error = refused(capsys, *command, path)
        assert str(path) in error and expected in error and "fuzzyarm evaluate --out" in error


@pytest.mark.parametrize("content", ["", "[]", "[" * 100_000, None])
def test_what_is_no_document_or_not_there_is_one_line(folder, capsys, content):
    path = folder / "results.json" if content is None else write(folder, content)
    error = refused(capsys, *CHECK, path)
    assert str(path) in error and (content is not None or "does not exist; make it again with" in error)


def test_an_unknown_policy_is_named(folder, document, capsys):
    text = json.dumps(document).replace("computed-torque", "computed-torrent")
    error = refused(capsys, *CHECK, write(folder, text))
    assert "unknown policy 'computed-torrent'; did you mean computed-torque?" in error


def test_the_published_file_reads():
    read_results(ROOT / "benchmarks" / "results" / "evaluate.json")
