"""What a report reads: a damaged folder is one line; rollouts bit for bit; tubes of bounds."""

import dataclasses
import json
import os
import re
import shutil

import numpy as np
import pytest
from support.command_line import refused
from support.results import identical

from fuzzyarm import Rollout, TipClaim, find_bound, save_bound
from fuzzyarm.eval.episodes.rollout_file import digest, read_rollouts, write_rollouts
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.report.certificates import checked_bounds, tube_section
from fuzzyarm.proof.tip.plant import PlantSet


def refusal(folder, capsys):
    """Return the line that `fuzzyarm report` prints, and check that it wrote nothing."""
    before = {path: path.read_bytes() for path in folder.iterdir()}
    error = refused(capsys, "report", folder)
    assert before == {path: path.read_bytes() for path in folder.iterdir()}
    return error


@pytest.fixture
def copy(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy")


def change(folder, **values):
    path = folder / "results.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_what_is_read_is_what_was_evaluated(evaluation, folder):
    stored = read_evaluation(folder)
    for name in ("config", "rows", "certificates", "bounds"):
        assert getattr(stored, name) == getattr(evaluation, name)


def half_a_number(folder):
    results = json.loads((folder / "results.json").read_text())["results"]
    results[3]["tip_error_max_mm"] *= 0.5
    change(folder, results=results)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "rollouts.npz").unlink(), "the evaluation was interrupted; run fuzzyarm evaluate -"),
        (lambda folder: os.truncate(folder / "rollouts.npz", 10_000), "rollouts.npz is damaged"),
        (half_a_number, "tip_error_max_mm of fuzzy-4 in case machining is "),
        (lambda folder: change(folder, rollouts_sha256="0" * 64), "results.json come from different evaluations"),
        (lambda folder: change(folder, versions={"fuzzyarm": "0"}), "was made by fuzzyarm 0, but this is version "),
    ],
)
def test_what_is_not_whole_is_refused(copy, capsys, damage, message):
    damage(copy)
    assert message in refusal(copy, capsys)


@pytest.mark.parametrize(
    ("name", "message"), [("report.txt", "must be a file ending in .html"), ("no/such/report.html", "does not exist")]
)
def test_a_bad_place_for_the_page(folder, tmp_path, capsys, name, message):
    assert message in refused(capsys, "report", folder, "--out", tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_episodes_that_were_not_asked_for(copy, capsys):
    document = json.loads((copy / "results.json").read_text())
    change(copy, config=document["config"] | {"cases": ["machining", "nominal"]})
    assert "its rows are out of order: (case, policy, seed) is ('nominal', " in refusal(copy, capsys)
    change(copy, results=sorted(document["results"], key=lambda row: row["case"]))
    assert "does not contain the episodes of the configuration" in refusal(copy, capsys)


FIELDS = [field.name for field in dataclasses.fields(Rollout)]


def test_a_round_trip_keeps_every_bit(evaluation, tmp_path):
    again = read_rollouts(write_rollouts(evaluation.rollouts, tmp_path))
    for before, after in zip(evaluation.rollouts, again, strict=True):
        for name in FIELDS:
            assert identical(getattr(before, name), getattr(after, name)), name
    assert digest(again) == digest(evaluation.rollouts)


def test_the_digest_sees_a_change_in_any_field(evaluation):
    run = evaluation.rollouts[0]
    for name in FIELDS:
        value = getattr(run, name)
        if isinstance(value, np.ndarray):
            value = value.copy() if value.size else np.zeros((1, 1))  # beliefs, of a policy that says nothing
            value.flat[-1] = np.nextafter(value.flat[-1], np.inf)
        else:
            value = {str: "other", bool: False, int: 1, float: 0.5, tuple: ("payload",)}[type(value)]
        assert digest([dataclasses.replace(run, **{name: value})]) != digest([run]), name


@pytest.mark.parametrize("number", [1e300, -1e61, np.nan, np.inf])
def test_a_number_whose_square_is_none_is_told(evaluation, tmp_path, number):
    run = evaluation.rollouts[0]
    position = run.q_motor.copy()
    position[3, 1] = number
    path = write_rollouts([dataclasses.replace(run, q_motor=position)], tmp_path)
    said = r"rollouts\.npz is damaged \(q_motor contains a number .* not within ±1e\+60\)"
    with pytest.raises(ValueError, match=said):
        read_rollouts(path)


STEPS = 15


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    out = tmp_path_factory.mktemp("tube") / "bound.json"
    save_bound(find_bound(TipClaim("fuzzy-4-tip", "nominal", "table-1", PlantSet(), steps=STEPS)), out)
    return out


def test_the_simulated_tip_is_drawn_within_the_tube(evaluation, path):
    checks = checked_bounds([path])
    section = tube_section(checks, evaluation.rollouts)
    assert "fuzzy-4-tip: tip within" in section and "for set table-1, proven" in section
    drawn = {
        name: np.array([list(map(float, pair.split(","))) for pair in points.split()])
        for name, points in re.findall(r'class="(band|path|tip)" points="([^"]*)"', section)
    }
    outer, inner = drawn["band"][:STEPS], drawn["band"][: STEPS - 1 : -1]
    np.testing.assert_allclose(0.5 * (outer + inner), drawn["path"], atol=0.11)
    half, off = (0.5 * np.hypot(*(outer - inner).T), np.hypot(*(drawn["tip"] - drawn["path"]).T))
    assert (off <= half + 0.2).all() and half.max() > 10.0 and off.max() > 5.0  # a digit of a pixel each
    share = 100.0 * evaluation.rollouts[2].tip_error[:STEPS].max() / checks[0].bound
    assert 0.0 < share <= 100.0 and f"{share:.3g} % of the bound</text>" in section


def test_a_bound_that_is_not_proven_or_of_another_episode_is_refused(evaluation, path, tmp_path):
    (check,) = checked_bounds([path])
    other = dataclasses.replace(check, claim=dataclasses.replace(check.claim, path="lemniscate"))
    with pytest.raises(ValueError, match="no episode of fuzzy-4-tip in case nominal on the lemniscate"):
        tube_section([other], evaluation.rollouts)
    content, forged = json.loads(path.read_text()), tmp_path / "forged.json"
    forged.write_text(json.dumps(content | {"bound": 0.5 * content["bound"]}))
    with pytest.raises(ValueError, match=r"forged\.json is not proven"):
        checked_bounds([forged])
