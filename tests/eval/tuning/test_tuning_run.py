"""The run of a tuning: kept steps, resuming, and what is refused. The searches themselves are stood in for."""

import json

import pytest
from support.command_line import one_line_error

from fuzzyarm.cli import main
from fuzzyarm.eval.stability.margins import _LIMITS
from fuzzyarm.eval.tuning import _steps as steps
from fuzzyarm.eval.tuning import run as tuning
from fuzzyarm.eval.tuning._finding import read_finding
from fuzzyarm.eval.tuning._search import Found
from fuzzyarm.policies.registry import COMPUTED_TORQUE, ELASTIC_OBSERVER
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
    two = (
        chose(COMPUTED_TORQUE, {"bandwidth": 40.0}, made),
        chose(ELASTIC_OBSERVER, None, made, radii={"nominal": 1.2}),
    )
    monkeypatch.setattr(tuning, "steps_for", lambda arm: two)
    return made


@pytest.fixture
def quick_margins(monkeypatch):
    """Stand in for the margins, which take a second."""
    row = {"policy": "computed-torque", "control_period": 1e-3, "spectral_radius": RADII, "reasons": {}}
    document = {
        "rows": [{**row, "loop_gain": dict.fromkeys(_LIMITS)}],
        "method": {"control_period": 1e-3, "postures": 1},
    }
    monkeypatch.setattr(tuning, "measure_margins", lambda config, advance: document)


def contents(folder):
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    margins = json.loads(files.pop("margins.json"))
    return files, margins["rows"]


def test_a_tuning_writes_a_whole_folder(tmp_path, calls, capsys, few_postures):
    out = tmp_path / "my-arm"
    assert main(["tune", "--out", str(out), "--jobs", "1"]) == 0
    said = capsys.readouterr().out
    assert "computed-torque: bandwidth 40 rad/s" in said and "elastic-observer: left out" in said
    files, rows = contents(out)
    assert set(files) == {"robot.toml", NAME, "README.md", "steps/computed-torque.json", "steps/elastic-observer.json"}
    assert [row["policy"] for row in rows] == ["computed-torque", "computed-torque-tip"]
    page = files["README.md"].decode()
    assert "bandwidth 40 rad/s" in page and "Not stable in these conditions (measured): 5 kg payload." in page


def test_an_interrupted_tuning_goes_on_to_the_same_folder(tmp_path, calls, quick_margins, monkeypatch, capsys):
    whole, broken = tmp_path / "whole" / "arm", tmp_path / "broken" / "arm"
    for folder in (whole, broken):
        folder.parent.mkdir()
    assert main(["tune", "--out", str(whole), "--jobs", "1"]) == 0
    last = tuning.steps_for(None)

    def interrupt(context):
        raise KeyboardInterrupt

    monkeypatch.setattr(tuning, "steps_for", lambda arm: (last[0], steps.TuningStep(ELASTIC_OBSERVER, 3, interrupt)))
    assert main(["tune", "--out", str(broken), "--jobs", "1"]) == 130
    assert "--resume" in capsys.readouterr().err and not (broken / NAME).exists()
    monkeypatch.setattr(tuning, "steps_for", lambda arm: last)
    calls.clear()
    assert main(["tune", "--out", str(broken), "--jobs", "1", "--resume"]) == 0
    assert calls == [ELASTIC_OBSERVER] and contents(broken) == contents(whole)


def test_a_tuning_that_was_killed_while_it_wrote_the_arm_can_be_begun_again(tmp_path, calls, quick_margins):
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / ".robot.toml.0a1b2c3d.part").write_text("[ro")
    assert main(["tune", "--out", str(tmp_path / "arm"), "--jobs", "1"]) == 0


def test_no_stable_gains_are_a_result_that_fails(tmp_path, calls, monkeypatch, capsys):
    only = tuning.steps_for(None)[1:]
    monkeypatch.setattr(tuning, "steps_for", lambda arm: only)
    assert main(["tune", "--out", str(tmp_path / "arm"), "--jobs", "1"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "no policy has stable gains" in error
    assert not (tmp_path / "arm" / NAME).exists()


def test_what_cannot_be_tuned_is_refused_in_one_line(tmp_path, calls, quick_margins, capsys):
    out, weak = tmp_path / "arm", tmp_path / "weak.toml"
    weak.write_text("torque_limit = [50.0, 25.0]\n", encoding="utf-8")

    def refused(*words):
        assert main(["tune", *words]) == 2
        return one_line_error(capsys)

    assert (
        "cannot hold its own weight: joint 1 needs" in refused("--robot", str(weak), "--out", str(out))
        and not out.exists()
    )
    assert "no tuning to resume" in refused("--out", str(out), "--resume") and not out.exists()
    assert main(["tune", "--out", str(out), "--jobs", "1"]) == 0
    assert "add --resume" in refused("--out", str(out))
    (tmp_path / "other.toml").write_text("mass = [14.0, 9.0]\n", encoding="utf-8")
    assert "another arm" in refused("--robot", str(tmp_path / "other.toml"), "--out", str(out), "--resume")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").touch()
    assert "not empty; choose another" in refused("--out", str(tmp_path / "full"))
    assert "jobs" in refused("--out", str(tmp_path / "new"), "--jobs", "0") and not (tmp_path / "new").exists()
    path = out / "steps" / "computed-torque.json"
    good = json.loads(path.read_text(encoding="utf-8"))
    for change in ({"arm_sha256": "0"}, {"chosen": {"bandwidth": "x"}}, {"schema": "other"}, {"more": 1}):
        path.write_text(json.dumps(good | change), encoding="utf-8")
        refused("--out", str(out), "--resume")
    assert read_finding(out, "fuzzy-4", good["arm_sha256"]) is None
