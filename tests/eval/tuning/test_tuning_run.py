"""The run of a tuning with searches that are stood in for, and, slow, whole tunings: of Table 1 and of other arms."""

import json
from unittest import mock

import numpy as np
import pytest
from support.command_line import one_line_error, printed, refused

from fuzzyarm import ArmParameters, Controller, EvaluationConfig, evaluate, tune_arm
from fuzzyarm.cli import main
from fuzzyarm.envs.physics.equations import chosen_arm
from fuzzyarm.eval.tuning import _steps as steps
from fuzzyarm.eval.tuning import run as tuning
from fuzzyarm.eval.tuning._finding import read_finding
from fuzzyarm.eval.tuning._search import Found
from fuzzyarm.fuzzy_policy.laws.computed_torque import _BANDWIDTH
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights
from fuzzyarm.policies import policies_of
from fuzzyarm.policies.registry import COMPUTED_TORQUE, ELASTIC_OBSERVER, POLICIES
from fuzzyarm.policies.tuned import NAME

RADII = {"nominal": 0.99, "5 kg payload": 1.01}


def chose(policy, chosen, calls, radii=RADII):
    def find(context):
        calls.append(policy)
        context.advance()
        return Found(chosen, {"error": float("nan")}, radii, 3)

    return steps.TuningStep(policy, 3, find)


@pytest.fixture
def calls(monkeypatch):
    made = []
    law = chose(COMPUTED_TORQUE, {"bandwidth": 40.0}, made)
    observer = chose(ELASTIC_OBSERVER, None, made, radii={"nominal": 1.2})
    monkeypatch.setattr(tuning, "steps_for", lambda arm: (law, observer))
    return made


def contents(folder):
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    margins = json.loads(files.pop("margins.json"))
    return files, margins["rows"]


def test_a_tuning_writes_a_whole_folder(tmp_path, calls, capsys, few_postures):
    out = tmp_path / "my-arm"
    said = printed(capsys, "tune", "--out", out, "--jobs", "1")
    assert "computed-torque: bandwidth 40 rad/s" in said and "elastic-observer: left out" in said
    files, rows = contents(out)
    assert set(files) == {"robot.toml", NAME, "README.md", "steps/computed-torque.json", "steps/elastic-observer.json"}
    assert [row["policy"] for row in rows] == ["computed-torque", "computed-torque-tip"]
    page = files["README.md"].decode()
    assert "bandwidth 40 rad/s" in page and "Not stable in these conditions (measured): 5 kg payload." in page


def test_an_interrupted_tuning_goes_on_to_the_same_folder(tmp_path, calls, few_postures, monkeypatch, capsys):
    whole, broken = tmp_path / "whole" / "arm", tmp_path / "broken" / "arm"
    whole.parent.mkdir()
    broken.parent.mkdir()
    assert main(["tune", "--out", str(whole), "--jobs", "1"]) == 0
    last, interrupted = tuning.steps_for(None), mock.Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr(tuning, "steps_for", lambda arm: (last[0], steps.TuningStep(ELASTIC_OBSERVER, 3, interrupted)))
    assert main(["tune", "--out", str(broken), "--jobs", "1"]) == 130
    assert "--resume" in capsys.readouterr().err and not (broken / NAME).exists()
    monkeypatch.setattr(tuning, "steps_for", lambda arm: last)
    calls.clear()
    assert main(["tune", "--out", str(broken), "--jobs", "1", "--resume"]) == 0
    assert calls == [ELASTIC_OBSERVER] and contents(broken) == contents(whole)


def test_a_tuning_that_was_killed_while_it_wrote_the_arm_can_be_begun_again(tmp_path, calls, few_postures):
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / ".robot.toml.0a1b2c3d.part").write_text("[ro")
    assert main(["tune", "--out", str(tmp_path / "arm"), "--jobs", "1"]) == 0


def test_no_stable_gains_are_a_result_that_fails(tmp_path, calls, monkeypatch, capsys):
    only = tuning.steps_for(None)[1:]
    monkeypatch.setattr(tuning, "steps_for", lambda arm: only)
    assert main(["tune", "--out", str(tmp_path / "arm"), "--jobs", "1"]) == 1
    assert "no policy has stable gains" in one_line_error(capsys)
    assert not (tmp_path / "arm" / NAME).exists()


def test_what_cannot_be_tuned_is_refused_in_one_line(tmp_path, calls, few_postures, capsys):
    out, weak, other = (tmp_path / name for name in ("arm", "weak.toml", "other.toml"))
    weak.write_text("torque_limit = [50.0, 25.0]\n", encoding="utf-8")

    def refusal(*words, folder=out):
        return refused(capsys, "tune", *words, "--out", folder)

    assert "cannot hold its own weight: joint 1 needs" in refusal("--robot", weak)
    assert "no tuning to resume" in refusal("--resume")
    assert "jobs" in refusal("--jobs", "0") and not out.exists()
    assert main(["tune", "--out", str(out), "--jobs", "1"]) == 0
    assert "add --resume" in refusal()
    other.write_text("mass = [14.0, 9.0]\n", encoding="utf-8")
    assert "another arm" in refusal("--robot", other, "--resume")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").touch()
    assert "not empty; choose another" in refusal(folder=tmp_path / "full")
    path = out / "steps" / "computed-torque.json"
    good = json.loads(path.read_text(encoding="utf-8"))
    for change in ({"arm_sha256": "0"}, {"chosen": {"bandwidth": "x"}}, {"schema": "other"}, {"more": 1}):
        path.write_text(json.dumps(good | change), encoding="utf-8")
        refusal("--resume")
    assert read_finding(out, "fuzzy-4", good["arm_sha256"]) is None


@pytest.mark.slow
def test_table_1_gives_the_shipped_numbers_back(tmp_path):
    laws = tune_arm(ArmParameters(), tmp_path, jobs=2).laws
    made, shipped = (Controller.load(path) for path in (tmp_path / "fuzzy-4.json", POLICIES["fuzzy-4"].path))
    assert made.model == shipped.model
    for name in ("alpha", "gamma", "fastest_pole"):
        assert getattr(made, name) == pytest.approx(getattr(shipped, name), rel=1e-6)
    np.testing.assert_allclose(made.gains, shipped.gains, rtol=1e-5, atol=1e-5 * np.abs(shipped.gains).max())
    assert laws.bandwidth == _BANDWIDTH and laws.numbers()[ELASTIC_OBSERVER] == ObserverWeights()


SOFT = ArmParameters(length=(0.5, 0.4), stiffness=(8e3, 5e3))
LONG = ArmParameters(length=(0.6, 0.45), stiffness=(3e4, 6e3))


@pytest.mark.slow
@pytest.mark.parametrize("arm", [SOFT, LONG, chosen_arm("planar-3r", None)], ids=["soft", "long", "planar-3r"])
def test_an_arm_of_ones_own_gets_policies_that_lose_no_case(tmp_path, arm):
    found = tune_arm(arm, tmp_path, jobs=2)
    assert {"fuzzy-4", "computed-torque", "elastic-observer"} <= set(found.laws.policies)
    for row in found.margins["rows"]:
        if row["policy"] != "adaptive-observer":  # its margins are those of its frozen loop
            assert all(radius < 1.0 for radius in row["spectral_radius"].values()), row
    assert evaluate(EvaluationConfig(policies=policies_of(str(tmp_path)), robot=arm)).complete
