"""`fuzzyarm margins` from a user's view: outputs, exit codes, one-line errors, whole files."""

import functools
import json
import os

import pytest
from support.command_line import one_line_error

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.synthesis import Specification, design

QUICK = ["margins", "--policy", "computed-torque"]


@functools.cache
def margins_of_computed_torque():
    return policy_margins(load_policy("computed-torque"), ArmParameters(), 1e-3)


@pytest.fixture
def measured(monkeypatch):
    """Let every policy have the margins of computed torque, which are measured once."""
    monkeypatch.setattr("fuzzyarm.eval.stability.margins.policy_margins", lambda *_: margins_of_computed_torque())


@pytest.mark.usefixtures("measured")
def test_a_table_and_what_it_means(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(QUICK) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[0].startswith("policy")
    assert "5 kg payload loop gain from" in out
    assert out.splitlines()[1].startswith("computed-torque  0.9924")
    assert "A local measurement and not a proof: postures frozen, dry friction removed" in out
    assert "\x1b" not in out and err == ""  # plain when piped, progress in a terminal only
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("measured")
def test_json_is_the_file(tmp_path, capsys):
    path = tmp_path / "margins.json"
    assert main([*QUICK, "--policy", "fuzzy-4", "--json", "--out", str(path)]) == 0
    printed = capsys.readouterr().out
    assert printed == path.read_text(encoding="utf-8")
    assert [row["policy"] for row in json.loads(printed)["rows"]] == ["computed-torque", "fuzzy-4"]
    assert list(tmp_path.iterdir()) == [path]


def test_another_arm_is_that_of_plant_and_policy(tmp_path, capsys):
    """An unstable loop is a result: the word in the table, exit code 0."""
    robot = tmp_path / "arm.toml"
    robot.write_text("motor_inertia = [0.1, 0.1]\n")
    assert main([*QUICK, "--robot", str(robot)]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[1].split().count("unstable") == 8
    assert "computed-torque, no 'loop gain from' or 'to' or 'to, one sample later': unstable with its own" in out


def test_a_controller_file(tmp_path, capsys, few_postures):
    path = tmp_path / "mine.json"
    design(Specification(kept=(), integral=False)).controller.save(path)
    assert main(["margins", "--policy", str(path)]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[1].startswith("mine  ")
    assert "mine, no 'loop gain from': stable down to 0.01 times its loop gain" in out


@pytest.mark.usefixtures("measured")
def test_a_full_disk_leaves_the_old_file_and_no_half_one(tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    path = tmp_path / "margins.json"
    path.write_text("the old one")
    monkeypatch.setattr(os, "replace", full)
    assert main([*QUICK, "--out", str(path)]) == 2
    assert "No space left" in one_line_error(capsys)
    assert list(tmp_path.iterdir()) == [path] and path.read_text() == "the old one"
