"""Sweeps of policies that are the user's own code."""

import sys

import numpy as np
import pytest
from support.command_line import refused

from fuzzyarm.cli import main

pytestmark = pytest.mark.usefixtures("undrawn")

QUICK = ["--case", "nominal", "--plants", "4", "--chunk", "2"]
ONE_CHUNK = ["--case", "nominal", "--plants", "2", "--jobs", "1"]

LAW = """
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from {package}.gains import SHARE

class Soft:
    def __init__(self, robot, control_period):
        self.law = ComputedTorquePolicy(robot, control_period)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        torque, state = self.law.predict(observation, state, episode_start, deterministic)
        return SHARE * torque, state

def make(robot, control_period):
    return Soft(robot, control_period)
"""
LOGGED = """
import os
with open(os.environ["IMPORTED_FROM"], "a") as file:
    file.write(__file__ + "\\n")
SHARE = {share}
"""


def package(folder, name, share=0.999):
    """Write a package of two modules with a policy, and return the policy's name."""
    (folder / name).mkdir(exist_ok=True)
    (folder / name / "__init__.py").write_text("")
    (folder / name / "law.py").write_text(LAW.format(package=name))
    (folder / name / "gains.py").write_text(LOGGED.format(share=share))
    return f"{name}.law:make"


@pytest.fixture
def imported(tmp_path, monkeypatch):
    """Import from a folder of the test's; return the file that tells where the policy was imported from."""
    log = tmp_path / "imported.txt"
    log.touch()
    monkeypatch.setenv("IMPORTED_FROM", str(log))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return log


@pytest.mark.slow
def test_local_processes_run_a_policy_of_ones_own_with_the_numbers_of_one(imported, tmp_path):
    policy = package(tmp_path, "swept_locally")
    for jobs in ("1", "2"):
        arguments = ["--policy", policy, "--policy", "computed-torque", *QUICK, "--jobs", jobs, "--out", jobs]
        assert main(["sweep", *arguments]) == 0
    found, other = (np.load(tmp_path / jobs / "episodes.npz") for jobs in ("1", "2"))
    assert all(np.array_equal(found[name], other[name]) for name in found.files)
    own, plain = found["max_mm"][:, 0]
    assert np.all(own != plain)  # each has its own numbers
    assert len(imported.read_text().splitlines()) >= 2  # by this process and by a worker
    assert main(["sweep", "--replay", policy, "nominal", "3", "--policy", policy, "--out", "1"]) == 0
    signals = np.load(tmp_path / "1" / "replay-swept_locally.law-make-nominal-3" / "episode.npz")
    assert 1e3 * signals["tip_error"].max() == own[3]


def test_code_that_only_the_folder_names_does_not_run(imported, tmp_path, capsys, short):
    policy = package(tmp_path, "swept_with_consent")
    begun = ["--policy", policy, "--policy", "fuzzy-1", *ONE_CHUNK, "--out", "sweep"]
    assert main(["sweep", *begun]) == 0
    capsys.readouterr()
    for module in [name for name in sys.modules if name.partition(".")[0] == "swept_with_consent"]:
        del sys.modules[module]
    imported.write_text("")
    for arguments in (["--resume"], ["--replay", policy, "nominal", "0"], ["--resume", "--policy", "fuzzy-1"]):
        assert f"add --policy {policy}" in refused(capsys, "sweep", *arguments, "--out", "sweep")
    assert imported.read_text() == ""  # nothing was imported
    resumed = ["sweep", "--resume", "--out", "sweep", "--policy", policy]
    assert "contains a sweep with policies" in refused(capsys, *resumed, "--policy", "fuzzy-2")
    for others in ([], ["--policy", "fuzzy-1"]):
        assert main([*resumed, *others]) == 0


def test_code_that_changed_is_not_mixed_in(imported, tmp_path, capsys, short):
    policy = package(tmp_path, "swept_twice")
    assert main(["sweep", "--policy", policy, *ONE_CHUNK, "--out", "sweep"]) == 0
    capsys.readouterr()
    package(tmp_path, "swept_twice", share=0.998)
    error = refused(capsys, "sweep", "--resume", "--policy", policy, "--out", "sweep")
    assert "or policy files (policies: swept_twice.law:make: swept_twice/gains.py" in error
