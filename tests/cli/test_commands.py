"""The command line from a user's view: outputs, exit codes, one-line errors, whole files."""

import dataclasses
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from slow_twins import slow_but
from support.command_line import one_line_error, printed, without_progress
from support.shipped import CONTROLLERS

from fuzzyarm.cli import main
from fuzzyarm.eval.evaluation import figures
from fuzzyarm.fuzzy_policy.controller import Controller, consistent_feedforward

FUZZY_1 = str(CONTROLLERS["fuzzy-1"])
QUICK = ["evaluate", "--policy", "fuzzy-4", "--case", "nominal"]


def test_evaluate_prints_a_table_and_writes_results_and_figures(tmp_path, capsys, monkeypatch):
    """Of the figures the overview, and of it the first row: each takes longer than the episode."""
    draw = figures.draw_figures
    monkeypatch.setattr(figures, "_time_figures", lambda joints: {})
    monkeypatch.setattr(figures, "_OVERVIEW", figures._OVERVIEW[:1])
    monkeypatch.setattr(figures, "draw_figures", lambda *given: {"overview": draw(*given)["overview"]})
    out = printed(capsys, *QUICK, "--out", tmp_path)
    assert "fuzzy-4 1.75 / 3.90   4.04\n" in out
    assert "fuzzy-4: proven for the rigid arm: alpha = 20 1/s, gamma = 0.00014; see fuzzyarm show fuzzy-4\n" in out
    assert "\x1b" not in out  # plain when piped
    assert "largest [mm]" in out  # rich would take the unit for markup
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"results.json", "results.csv", "rollouts.npz", "overview.png", "overview.svg"}


@pytest.mark.usefixtures("undrawn")
def test_evaluate_json_is_the_results_file(tmp_path, capsys):
    document = json.loads(printed(capsys, *QUICK, "--json", "--out", tmp_path))
    assert document == json.loads((tmp_path / "results.json").read_text())


@pytest.mark.usefixtures("undrawn")
def test_what_a_file_leaves_to_table_1_is_named_once_and_in_the_results(tmp_path, capsys):
    file, out = tmp_path / "arm.toml", tmp_path / "out"
    file.write_text("length = [0.5, 0.4]\nmass_center = [0.25, 0.2]\nviscous_friction = [0.14, 0.14]\n")
    arguments = ["--policy", "computed-torque", "computed-torque-tip", "--case", "nominal", "--out", str(out)]
    assert main(["evaluate", "--robot", str(file), *arguments]) == 0
    (line,) = without_progress(capsys.readouterr().err).splitlines()
    assert line.startswith(f"{file} does not set mass, inertia, gravity, motor_inertia, ")
    assert line.endswith(", velocity_limit: the values are taken from Table 1 of the paper")
    assert "torque_limit" in line and "viscous_friction" not in line and " length" not in line
    arm = json.loads((out / "results.json").read_text())["arm"]
    assert arm.startswith('{"length": [0.5, 0.4], "mass_center": [0.25, 0.2]}; as in Table 1 of the paper: mass, ')
    printed(capsys, "report", out, "--out", tmp_path / "page.html")
    assert "as in Table 1 of the paper: mass, inertia, viscous_friction" in (tmp_path / "page.html").read_text()


@pytest.mark.usefixtures("undrawn")
def test_design_writes_a_controller_that_evaluate_takes(tmp_path, capsys):
    path = tmp_path / "mine.json"
    out = printed(capsys, "design", "--rules", "1", "--no-integral", "--out", path)
    described = "1 rules: kept none", "alpha = 20 1/s", "exact rational arithmetic", "K dq2", "Not covered"
    assert all(part in out for part in (*described, "sampled every 1 ms", "spectral radius: nominal 0.")), out
    assert Controller.load(path).model.rules == 1
    assert main(["evaluate", "--policy", str(path), "--case", "nominal", "--out", str(tmp_path)]) == 0


def test_an_infeasible_design_writes_nothing_and_exits_with_1(tmp_path, capsys):
    path = tmp_path / "never.json"
    arguments = ["--rules", "1", "--no-integral", "--alpha", "400", "--gain-bound", "1e5", "--out", str(path)]
    assert main(["design", *arguments]) == 1
    error = one_line_error(capsys)
    assert re.search(r"alpha to about \d.*, the largest that works", error) and "gain bound 100000 N m/rad" in error
    assert not path.exists()


@pytest.mark.parametrize(
    "words", slow_but([["--help"]], [["--help"], ["train", "ppo", "--help"], ["verify", "--json", FUZZY_1]])
)
def test_a_reader_that_leaves_is_no_error(words):
    """As head does: the exit code of a broken pipe, and not a word."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-m", "fuzzyarm", *words], stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


def test_verify_proves_files_and_says_what_for(capsys):
    files = [CONTROLLERS["fuzzy-4"], CONTROLLERS["paper-1-common"]]
    out = printed(capsys, "verify", *files)
    assert out.count(": PROVEN") == 2
    assert "13 of 13 inequalities proven in exact rational arithmetic" in out
    assert "poles of the loop frozen at any such state have real parts between -200 and -20 1/s" in out
    assert out.count("for the error from theta_d") == 1  # the consistent form only
    assert out.count("Not covered: the elastic joints") == 2
    assert "proven     P > 0, margin" in out
    assert "feedforward residual in d is at most" in out
    (report,) = json.loads(printed(capsys, "verify", "--json", files[0]))
    assert report["proven"] and all(claim["proven"] for claim in report["claims"])


def test_verify_names_what_fails_and_exits_with_1(tmp_path, capsys):
    dataclasses.replace(Controller.load(CONTROLLERS["fuzzy-4"]), alpha=60.0).save(tmp_path / "wrong.json")
    assert main(["verify", str(tmp_path / "wrong.json")]) == 1
    out = capsys.readouterr().out
    assert "NOT PROVEN" in out and "not proven Psi_1,1,1 < 0, margin -" in out
    assert "Not covered" not in out  # no statement without a proof


@pytest.mark.usefixtures("unmeasured")
def test_design_in_the_form_of_the_paper(tmp_path, capsys):
    path = tmp_path / "paper.json"
    words = ["design", "--theorem", "paper", "--rules", "1", "--no-integral", "--common-multiplier", "--out", path]
    assert "paper form, without integral" in printed(capsys, *words)
    made = Controller.load(path)
    assert made.common_multiplier and not made.feedforward.any()
    printed(capsys, *words, "--feedforward", "0.5")
    half = Controller.load(path)
    np.testing.assert_allclose(half.feedforward, 0.5 * consistent_feedforward(half.model), rtol=1e-12)


def test_bench_writes_a_file_where_it_is_asked_to(tmp_path, capsys, monkeypatch):
    from fuzzyarm.eval.bench import run as bench
    from fuzzyarm.eval.bench._entries import single_entries

    entry = dataclasses.replace(single_entries()[0], tip_error=None)
    monkeypatch.setattr(bench, "_WARM_UP", 0.0)
    monkeypatch.setattr(bench.BenchConfig, "groups", lambda self: {"one environment": [entry]})
    monkeypatch.setattr(bench.BenchConfig, "sweep_groups", lambda self: {"sweep": [entry]} if self.lanes_sweep else {})
    monkeypatch.setattr(bench, "_memory_per_lane", lambda: 321.0)
    monkeypatch.chdir(tmp_path)
    out = printed(capsys, "bench", "--seconds", "1e-4")
    assert "FuzzyArm-v0, machine code" in out and "\x1b" not in out and list(tmp_path.iterdir()) == []
    document = json.loads(printed(capsys, "bench", "--seconds", "1e-4", "--json", "--lanes-sweep", "--out", "new"))
    assert document == json.loads((tmp_path / "new" / "bench.json").read_text())
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"bench.json", "throughput.png"}


MARGINS = ["margins", "--policy", "computed-torque"]


@pytest.mark.usefixtures("few_postures")
def test_margins_are_a_table_and_what_it_means_and_a_file(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(MARGINS) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[0].startswith("policy") and "5 kg payload loop gain from" in out
    assert out.splitlines()[1].startswith("computed-torque  0.99")
    assert "This is a local measurement, not a proof: postures are frozen, dry friction is removed" in out
    assert "\x1b" not in out and without_progress(err) == ""  # plain when piped
    assert list(tmp_path.iterdir()) == []
    text = printed(capsys, *MARGINS, "--policy", "fuzzy-4", "--json", "--out", "margins.json")
    assert text == (tmp_path / "margins.json").read_text(encoding="utf-8")
    assert [row["policy"] for row in json.loads(text)["rows"]] == ["computed-torque", "fuzzy-4"]
    assert [path.name for path in tmp_path.iterdir()] == ["margins.json"]


def test_another_arm_is_that_of_plant_and_policy(tmp_path, capsys):
    """An unstable loop is a result: the word in the table, exit code 0."""
    (tmp_path / "arm.toml").write_text("motor_inertia = [0.1, 0.1]\n")
    assert main([*MARGINS, "--robot", str(tmp_path / "arm.toml")]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[1].split().count("unstable") == 8
    assert "computed-torque has no 'loop gain from' or 'to' or 'to, one sample later': unstable at the" in out


@pytest.mark.usefixtures("unmeasured")
def test_design_objectives(tmp_path, capsys):
    words = ["design", "--rules", "1", "--no-integral", "--out", tmp_path / "c.json"]
    assert "smallest L2 gain" in printed(capsys, *words, "--gamma", "min", "--gain-bound", "1e5")
    assert "largest decay rate" in printed(capsys, *words, "--alpha", "max", "--gain-bound", "2e5")
