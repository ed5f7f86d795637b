"""Policies ranked over plants: scores from the errors themselves, intervals, lost plants, and what is refused."""

import json

import numpy as np
import pytest

from fuzzyarm.cli import main
from fuzzyarm.eval.evaluation.ranking import markdown
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.distributions import plant_record
from fuzzyarm.eval.sweep.episodes import SweepResults
from fuzzyarm.eval.sweep.ranking import rank_sweeps
from fuzzyarm.eval.sweep.summary import summarise

PLANTS = 200


def document(errors, completed=None, **config):
    """What a sweep writes for largest errors (policies, cases, plants) [mm] of fuzzy-1, fuzzy-2, ..."""
    policies = tuple(f"fuzzy-{k}" for k in (1, 2, 4)[: len(errors)])
    whole = SweepConfig(policies=policies, cases=("nominal", "payload"), plants=errors.shape[-1], **config)
    completed = np.ones(errors.shape, bool) if completed is None else completed
    plants = np.zeros(errors.shape[-1], plant_record(2))
    return summarise(
        whole, SweepResults(plants, {"max_mm": errors, "rms_mm": 0.5 * errors}, np.ones(errors.shape), completed)
    )


@pytest.fixture
def write(tmp_path):
    def file(name, content):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "sweep.json"
        path.write_text(json.dumps(content), encoding="utf-8")
        return path

    return file


def drawn(policies, seed=0):
    return np.random.default_rng(seed).uniform(1.0, 2.0, (policies, 2, PLANTS))


def test_the_score_is_the_worst_case_s_quantile_over_the_plants(write):
    errors = drawn(2)
    errors[0, 0], errors[1, 0] = errors[0, 0] * 1e-3, errors[1, 0] * 3.0
    errors[0, 1] *= 2.0
    board = rank_sweeps([write("a", document(errors))])
    assert [standing.policy for standing in board.standings] == ["fuzzy-1", "fuzzy-2"]
    for standing, own, case in zip(board.standings, errors, (1, 0), strict=True):
        assert standing.score.mean == np.sort(own[case])[int(0.99 * PLANTS) - 1]
        assert standing.score.low <= standing.score.mean <= standing.score.high <= own.max()


def test_losing_more_than_one_in_a_hundred_ranks_last_and_losing_fewer_does_not(write):
    errors, completed = drawn(3), np.ones((3, 2, PLANTS), bool)
    completed[0, 1, :3], completed[1, 0, :1] = False, False
    errors[1:] *= 10.0
    errors[2] *= 2.0
    table = markdown(rank_sweeps([write("a", document(errors, completed)).parent]))
    ranks = [[cell.strip() for cell in line.split("|")[1:4]] for line in table.splitlines()[2:5]]
    assert [rank[:2] for rank in ranks] == [["1", "fuzzy-2"], ["2", "fuzzy-4"], ["3", "fuzzy-1"]]
    assert ranks[2][2] == "ended early" and "3 of 400" in table and "lost" not in table.lower()


def test_sweeps_of_other_plants_are_ranked_together_and_of_another_distribution_are_not(write, capsys):
    one, more = write("a", document(drawn(2))), write("b", document(3.0 * drawn(1, 1), seed=500))
    assert main(["leaderboard", str(one.parent), str(more), "--markdown"]) == 0
    assert capsys.readouterr().out.count("fuzzy-1") == 2
    other = write("c", document(drawn(1), distribution="all"))
    assert main(["leaderboard", str(one), str(other)]) == 2
    assert "not comparable: distribution" in capsys.readouterr().err


def test_what_cannot_be_ranked_is_refused_in_one_line(write, tmp_path, capsys):
    path = write("a", document(drawn(1)))
    damaged = json.loads(path.read_text())
    del damaged["rows"][0]["max_mm"]
    results = tmp_path / "results.json"
    results.write_text("{}")
    for words, message in (
        ([str(path), str(path.parent)], "given twice"),
        ([str(path), str(results)], "rank sweeps with sweeps"),
        ([str(path), "--bound", str(results)], "leave it out"),
        ([str(write("b", damaged))], "damaged ('max_mm' is missing)"),
        ([str(write("c", damaged | {"schema": "fuzzyarm-sweep/1"}))], "fuzzyarm-sweep/1"),
    ):
        assert main(["leaderboard", *words]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
