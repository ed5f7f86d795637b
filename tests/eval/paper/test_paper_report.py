"""The report of `fuzzyarm paper`, its exit codes, and which differences are drift."""

import json
import math

import pytest
from support.command_line import without_progress

from fuzzyarm.cli import main
from fuzzyarm.eval.paper import _report as drift
from fuzzyarm.eval.paper._claims import CLAIMS, PaperNumber
from fuzzyarm.eval.paper._report import _Value as Value
from fuzzyarm.eval.paper._report import _Values as Comparison
from fuzzyarm.eval.paper._report import load_expected


@pytest.fixture
def gathered(monkeypatch, evidence):
    """Let the command use the evidence of the session."""
    monkeypatch.setattr("fuzzyarm.eval.paper.evidence.gather", lambda progress=None: evidence)


@pytest.fixture
def undrawn(gathered, monkeypatch):
    """Let the command draw no figures."""
    monkeypatch.setattr("fuzzyarm.eval.paper.figures.write_figures", lambda evidence, folder, progress=None: [])


def run(*arguments):
    return main(["paper", *map(str, arguments)])


@pytest.mark.slow
def test_the_command_writes_tables_data_and_figures(gathered, tmp_path, capsys):
    assert run("--out", tmp_path) == 0
    out = capsys.readouterr()
    assert without_progress(out.err) == ""
    assert "\x1b" not in out.out
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"paper.md", "paper.json", *(f"figure-{number:02}.png" for number in range(2, 11))}
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert "| 5138, 1298, 338, 98 |" in text and "| 33816, 8728, 2328, 664 |" in text
    assert "![figure-02](figure-02.png)" in text
    for claim in CLAIMS:
        assert f"{claim.key}: {claim.quantity}" in text and f"{claim.key}: {claim.quantity}" in out.out
        assert claim.reason in text


def test_json_has_every_value_with_the_papers_and_what_it_was_made_with(undrawn, comparison, tmp_path, capsys):
    assert run("--json", "--out", tmp_path) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((tmp_path / "paper.json").read_text())
    assert {"commit", "versions", "machine"} <= document.keys()
    claims = {entry["key"]: entry for entry in document["claims"]}
    assert list(claims) == [claim.key for claim in CLAIMS]
    torque = {value["label"]: value for value in claims["peak-torque-1"]["values"]}["consistent-4"]
    assert (torque["paper"], torque["agrees"], torque["drifted"]) == (228.0, True, False)
    assert torque["measured"] == comparison.measured["peak-torque-1"]["consistent-4"]


def test_a_number_that_moved_is_named_and_exit_code_1(undrawn, tmp_path, capsys):
    moved = {key: dict(values) for key, values in load_expected().items()}
    moved["case-1-largest-tip"]["consistent-4"] *= 1.01
    moved["table-2-rows"]["4 rules"] += 1
    drift.store_expected(moved, {}, tmp_path / "moved.json")
    assert run("--expected", tmp_path / "moved.json", "--out", tmp_path) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("fuzzyarm paper: table-2-rows, 4 rules: measured 664, stored 665")
    assert lines[1].startswith("fuzzyarm paper: case-1-largest-tip, consistent-4: measured 2.51")
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert "2 of " in text and "- table-2-rows, 4 rules: measured 664" in text


def test_renew_writes_what_is_measured_and_leaves_the_package_alone(undrawn, comparison, tmp_path, capsys):
    shipped, expected = drift.EXPECTED.read_bytes(), tmp_path / "mine.json"
    assert run("--expected", expected, "--out", tmp_path / "first") == 2  # nothing is stored yet
    assert "mine.json" in capsys.readouterr().err
    assert run("--renew", expected, "--out", tmp_path / "first") == 0
    assert load_expected(expected) == comparison.measured  # exactly
    assert run("--expected", expected, "--out", tmp_path / "second") == 0
    assert drift.EXPECTED.read_bytes() == shipped


def test_bad_usage_is_one_line_and_exit_code_2(undrawn, tmp_path, capsys):
    occupied, damaged = tmp_path / "file", tmp_path / "damaged.json"
    occupied.write_text("mine")
    damaged.write_text("{}")
    for words, message in (
        (("--out", occupied), "fuzzyarm paper: cannot write to"),
        (("--expected", damaged, "--out", tmp_path / "out"), "--renew"),
        (("--expected", damaged, "--renew", damaged, "--out", tmp_path / "out"), "give only one"),
        (("--renew", occupied / "new.json", "--out", tmp_path / "out"), "cannot write to"),
    ):
        assert run(*words) == 2
        assert message in capsys.readouterr().err


CLAIM = PaperNumber("peak", "6.2", "228", "peak", "N m", 228.0, "", tolerance=(0.01, 1.0))


@pytest.mark.parametrize(
    ("measured", "stored", "drifted"),
    [
        (203.0, 200.0, False),
        (203.1, 200.0, True),
        (-203.0, -200.0, False),
        (-196.9, -200.0, True),
        (math.nan, 200.0, True),
        (-math.inf, -200.0, True),
    ],
)
def test_a_number_moves_beyond_its_tolerance(measured, stored, drifted):
    assert Value(CLAIM, "a", measured, stored).drifted is drifted


def test_a_number_that_is_new_or_gone_is_drift_and_named():
    stored = dict(load_expected())
    measured = stored | {"tip-speed": {"new": 1.0}}
    found = Comparison(measured, stored | {"other": {"x": 2.0}}, {}).drifted
    assert [(value.claim.key, value.label) for value in found] == [
        ("tip-speed", "reference"), ("tip-speed", "new"), ("other", "x")
    ]  # fmt: skip
    assert "tip-speed, reference: measured none, stored 1.57" in str(found[0])
    assert "tip-speed, new: measured 1 m/s, stored none" in str(found[1])
