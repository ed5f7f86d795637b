"""The report of `fuzzyarm paper`, its exit codes, which differences are drift, and the data that figures show."""

import json
import math

import numpy as np
import pytest
from support.command_line import printed, refused

from fuzzyarm.cli import main
from fuzzyarm.eval.paper import _report as drift
from fuzzyarm.eval.paper._claims import CLAIMS, PaperNumber
from fuzzyarm.eval.paper._report import _Value, _Values, load_expected
from fuzzyarm.eval.paper.figures import draw_figures


@pytest.fixture
def gathered(monkeypatch, evidence):
    monkeypatch.setattr("fuzzyarm.eval.paper.evidence.gather", lambda progress=None: evidence)


@pytest.fixture
def undrawn(gathered, monkeypatch):
    monkeypatch.setattr("fuzzyarm.eval.paper.figures.write_figures", lambda evidence, folder, progress=None: [])


@pytest.mark.slow
def test_the_command_writes_tables_data_and_figures(gathered, tmp_path, capsys):
    out = printed(capsys, "paper", "--out", tmp_path)
    assert "\x1b" not in out
    figures = {f"figure-{number:02}.png" for number in range(2, 11)}
    assert {path.name for path in tmp_path.iterdir()} == {"paper.md", "paper.json"} | figures
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert "| 5138, 1298, 338, 98 |" in text and "| 33816, 8728, 2328, 664 |" in text
    assert "![figure-02](figure-02.png)" in text
    for claim in CLAIMS:
        assert f"{claim.key}: {claim.quantity}" in text and f"{claim.key}: {claim.quantity}" in out
        assert claim.reason in text


def test_json_has_every_value_with_the_papers_and_what_it_was_made_with(undrawn, comparison, tmp_path, capsys):
    document = json.loads(printed(capsys, "paper", "--json", "--out", tmp_path))
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
    assert main(["paper", "--expected", str(tmp_path / "moved.json"), "--out", str(tmp_path)]) == 1
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("fuzzyarm paper: table-2-rows, 4 rules: measured 664, stored 665")
    assert second.startswith("fuzzyarm paper: case-1-largest-tip, consistent-4: measured 2.51")
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert "2 of " in text and "- table-2-rows, 4 rules: measured 664" in text


def test_renew_writes_what_is_measured_and_leaves_the_package_alone(undrawn, comparison, tmp_path, capsys):
    shipped, expected = drift.EXPECTED.read_bytes(), tmp_path / "mine.json"
    assert "mine.json" in refused(capsys, "paper", "--expected", expected, "--out", tmp_path / "first")  # not yet
    printed(capsys, "paper", "--renew", expected, "--out", tmp_path / "first")
    assert load_expected(expected) == comparison.measured  # exactly
    printed(capsys, "paper", "--expected", expected, "--out", tmp_path / "second")
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
        assert message in refused(capsys, "paper", *words)


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
    assert _Value(CLAIM, "a", measured, stored).drifted is drifted


def test_a_number_that_is_new_or_gone_is_drift_and_named():
    stored = dict(load_expected())
    measured = stored | {"tip-speed": {"new": 1.0}}
    gone, new, other = _Values(measured, stored | {"other": {"x": 2.0}}, {}).drifted
    assert "tip-speed, reference: measured none, stored 1.57" in str(gone)
    assert "tip-speed, new: measured 1 m/s, stored none" in str(new)
    assert (other.claim.key, other.label) == ("other", "x")


@pytest.fixture(scope="module")
def figures(evidence):
    return draw_figures(evidence)


def curves(axes):
    """Return the curves by their stroke: dotted and solid."""
    return {"solid" if line.get_linestyle() == "-" else "dotted": line.get_xydata() for line in axes.lines}


@pytest.mark.slow
@pytest.mark.parametrize(("number", "case"), [(4, "nominal"), (5, "machining"), (6, "payload")])
def test_circularity_is_drawn_on_both_sides_in_millimetres(figures, evidence, number, case):
    grid = np.reshape(figures[number].axes, (2, 2))
    for column, form in enumerate(("printed", "consistent")):
        for rules, stroke in ((32, "dotted"), (4, "solid")):
            run = evidence.rollouts[f"{form}-{rules}", case]
            for row, error in enumerate((run.circularity_error, run.circularity_error_motor)):
                np.testing.assert_array_equal(curves(grid[row, column])[stroke], np.c_[run.time, 1e3 * error])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "signal"),
    [
        (7, lambda run: run.torque),
        (8, lambda run: run.dq_motor),
        (9, lambda run: 1e3 * (run.q_motor - run.q_reference)),
        (10, lambda run: run.friction_torque),
    ],
)
def test_joint_figures_have_rules_by_row_and_joints_by_stroke(figures, evidence, number, signal):
    grid = np.reshape(figures[number].axes, (2, 2))
    for row, rules in enumerate((32, 4)):
        assert grid[row, 0].get_ylabel().startswith(f"{rules} rules")
        for column, form in enumerate(("printed", "consistent")):
            run, drawn = evidence.rollouts[f"{form}-{rules}", "nominal"], curves(grid[row, column])
            for joint, stroke in enumerate(("dotted", "solid")):
                np.testing.assert_array_equal(drawn[stroke], np.c_[run.time, signal(run)[:, joint]])
