"""The leaderboard: scores by hand, ranks, intervals, and files that must not be mixed."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from scipy.stats import trim_mean
from support.command_line import printed, refused

from fuzzyarm import ArmParameters, robot_named
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.eval.declarations import read_declarations, written_declarations
from fuzzyarm.eval.evaluation._statistics import estimate
from fuzzyarm.eval.evaluation.ranking import markdown, rank_policies
from fuzzyarm.eval.evaluation.results_file import conditions_of
from fuzzyarm.eval.evaluation.run import SCHEMA, EvaluationConfig, evaluate, write_results
from fuzzyarm.policies.declared import Declared

CASES = ("nominal", "machining", "payload")


def document(errors, *, cases=CASES, version="0.1.0", **config):
    """Results with these rms tip errors [mm]: by policy one list per case, of one number per seed; largest: twice."""
    seeds = len(next(iter(errors.values()))[0])
    return {
        "schema": SCHEMA,
        "config": {"policies": list(errors), "cases": list(cases), "seeds": seeds, "encoder_noise": [1e-5, 1e-3]}
        | {"control_period": 1e-3, "parameters": {}}
        | config,
        "versions": {"fuzzyarm": version},
        "machine": {"cpu": "any", "cores": 1, "system": "any"},
        **{"commit": None, "arm": "", "command": None, "date": "", "rollouts_sha256": ""},
        "policy_files": {name: {} for name in errors},
        "certified_bounds": dict.fromkeys(errors),
        "declared": written_declarations(read_declarations(None, list(errors))),
        "certificates": {name: "proven" if name.startswith("fuzzy") else None for name in errors},
        "results": [
            {"case": case, "policy": name, "seed": seed, "completed": True, "reason": ""}
            | {"tip_error_rms_mm": errors[name][k][seed], "tip_error_max_mm": 2.0 * errors[name][k][seed]}
            for k, case in enumerate(cases)
            for name in errors
            for seed in range(seeds)
        ],
    }


def ranked(*paths):
    board = rank_policies(paths)
    return [(rank, standing.policy) for rank, standing in zip(board.ranks, board.standings, strict=True)]


def test_the_score_is_the_largest_error_of_all_cases(write):
    board = rank_policies([write("a", document({"a": [[1e-6], [8.0], [7.0]], "b": [[1.0], [5.0], [6.0]]}))])
    assert [standing.policy for standing in board.standings] == ["b", "a"]
    assert [standing.score.mean for standing in board.standings] == pytest.approx([12.0, 16.0])
    assert board.standings[1].score[1:] == (None, None)  # one seed says nothing of the spread
    assert board.standings[1].rms == {"nominal": 1e-6, "machining": 8.0, "payload": 7.0}


def test_seeds_are_scored_one_by_one_and_then_estimated(write):
    errors = np.random.default_rng(0).lognormal(size=(3, 5))
    standing = rank_policies([write("a", document({"a": errors.tolist()}))]).standings[0]
    assert standing.score == pytest.approx(estimate(2.0 * errors.max(axis=0)), rel=1e-12)
    assert standing.score.low < standing.score.mean < standing.score.high
    assert standing.rms["payload"] == pytest.approx(np.sort(errors[2])[1:4].mean())


def test_the_smallest_comes_first_across_files_and_equals_share_a_rank(write):
    one = write("one", document({"c": [[3.0]] * 3, "a": [[1.0]] * 3}))
    two = write("two", document({"a": [[1.0]] * 3, "b": [[2.0]] * 3}))
    assert ranked(one, two.parent) == [(1, "a"), (1, "a"), (3, "b"), (4, "c")]
    assert [s.source for s in rank_policies([one, two.parent]).standings] == [str(p) for p in (one, two, two, one)]


def test_below_a_micrometre_nobody_is_ranked_and_no_number_is_printed(write):
    path = write("a", document({"a": [[4e-4]] * 3, "b": [[1e-4]] * 3, "c": [[6e-4]] * 3}))
    assert ranked(path) == [(1, "a"), (1, "b"), (3, "c")]  # scores are twice these errors
    board = rank_policies([path])
    assert [row[2] for row in board.sheet.rows] == ["< 0.001", "< 0.001", "0.00120"]
    assert all(row[3] == "< 0.001" for row in board.sheet.rows)
    assert board.standings[0].score.mean == pytest.approx(8e-4)


def test_who_lost_the_path_ranks_last_by_how_often(write):
    results = document({name: [[error]] * 3 for name, error in (("a", 1.0), ("b", 2.0), ("c", 3.0), ("d", 4.0))})
    rows = {(row["policy"], row["case"]): row for row in results["results"]}
    rows["a", "nominal"] |= {"completed": False, "reason": "left"}
    rows["a", "payload"]["tip_error_max_mm"] = 100.1
    rows["b", "machining"]["tip_error_max_mm"] = 100.1
    rows["c", "machining"]["tip_error_max_mm"] = 100.0  # at the limit is not beyond it
    path = write("a", results)
    assert ranked(path) == [(1, "d"), (2, "c"), (3, "b"), (4, "a")]
    standings = {standing.policy: standing for standing in rank_policies([path]).standings}
    assert (standings["a"].score, standings["a"].lost, standings["a"].episodes) == (None, 2, 3)
    assert standings["a"].rms == {"nominal": None, "machining": 1.0, "payload": None}
    assert standings["c"].score.mean == 100.0


FINE = {"a": [[1.0], [2.0], [3.0]]}
OTHERS = {
    "version": (document(FINE, version="0.2.0"), "version of fuzzyarm is 0.1.0 in the first and 0.2.0 in the second"),
    "seeds": (document({"a": [[1.0, 2.0]] * 3}), "number of seeds is 1 in the first and 2 in the second"),
    "arm": (document(FINE, parameters={"mass": [12.0, 9.0]}), "mass of the arm is [15.0, 9.0] in the first and [12.0"),
}
OTHER_FIELDS = {
    "cases": ("nominal",),
    "seeds": 2,
    "encoder_noise": (1e-6, 1e-4),
    "control_period": 2e-3,
    "parameters": ArmParameters(mass=(12.0, 9.0)),
    "robot": robot_named("ur5"),
    "path": "square",
    "points": GivenPath(((0.5, 0.5), (0.6, 0.5), (0.6, 0.6))),
    "force": (10.0, 20.0),
    "payload": 3.0,
    "passes": 2,
}  # what is not the default, with noise


def test_every_field_of_an_evaluation_but_the_policies_is_a_condition():
    assert {*OTHER_FIELDS, "policies"} == {field.name for field in dataclasses.fields(EvaluationConfig)}
    noisy = EvaluationConfig(encoder_noise=(1e-5, 1e-3))
    usual, said = conditions_of(noisy)
    for name, value in OTHER_FIELDS.items():
        found, words = conditions_of(dataclasses.replace(noisy, **{name: value}))
        assert [key for key in usual if found[key] != usual[key]], f"{name} is no condition"
        assert name == "cases" or words != said, f"{name} is not said"
    moved = GivenPath(((0.5, 0.5), (0.6, 0.5), (0.6, 0.61)))
    one, other = (dataclasses.replace(noisy, points=points) for points in (OTHER_FIELDS["points"], moved))
    assert conditions_of(one)[0] != conditions_of(other)[0]


@pytest.mark.parametrize(("other", "expected"), OTHERS.values(), ids=OTHERS)
def test_unlike_results_are_refused_with_the_difference(write, capsys, other, expected):
    paths = [write("one", document(FINE)), write("two", document({"b": FINE["a"]})), write("three", other)]
    error = refused(capsys, "leaderboard", *paths)
    assert expected in error and str(paths[0]) in error and str(paths[2]) in error


@pytest.mark.parametrize("wrong", [{}, {"a": {"objective": "o"}}, {"a": 3}])
def test_a_damaged_declaration_and_a_file_given_twice_are_one_line(write, capsys, wrong):
    damaged, path = write("damaged", document(FINE) | {"declared": wrong}), write("a", document(FINE))
    assert "declared" in refused(capsys, "leaderboard", damaged)
    assert "is given twice" in refused(capsys, "leaderboard", path, path.parent)


def test_the_table_of_real_results(tmp_path, capsys, short):
    evaluation = evaluate(EvaluationConfig(policies=("fuzzy-4", "computed-torque-tip"), cases=("nominal",)))
    path, _ = write_results(evaluation, tmp_path)
    out = printed(capsys, "leaderboard", path)
    assert "\x1b" not in out
    first, second = (line.split() for line in out.splitlines()[1:3])
    behind, best = (f"{row['tip_error_max_mm']:#.3g}" for row in evaluation.rows)
    assert first[:3] == ["1", "computed-torque-tip", best] and first[-2:] == ["-", str(path)]
    assert second[:3] == ["2", "fuzzy-4", behind] and second[-3:] == ["rigid", "arm", str(path)]
    assert "Score: largest tip error of all cases. Lost:" in out
    assert "control period 1 ms, 1 seed, no noise" in out


def test_what_is_proven_of_the_tip_stands_beside_its_policy(write):
    path = write("a", document({"a": [[1.0], [8.0], [27.0]], "b": [[1.0]] * 3}))
    board = rank_policies([path], {"b": "tip within 1 mm"})
    assert {standing.policy: standing.tip for standing in board.standings} == {"a": "", "b": "tip within 1 mm"}
    lines = [line for line in markdown(board).splitlines() if "tip within 1 mm" in line]
    assert len(lines) == 1 and "| b |" in lines[0]


def test_the_file_declares_and_not_the_name(write, capsys):
    mine = dict(zip(Declared._fields, ("small|error", "cases", "nothing", "all", "one"), strict=True))
    content = document({"mine": [[1.0]] * 3, "fuzzy-4": [[2.0]] * 3, "silent": [[3.0]] * 3})
    content["declared"] = {"mine": mine, "fuzzy-4": mine | {"objective": "another"}, "silent": None}
    path = write("a", content)
    out = printed(capsys, "leaderboard", path, "--declared", "--markdown")
    assert [line for line in out.splitlines() if line.startswith("| ")][-3:] == [
        "| mine | small&#124;error | cases | nothing | all | one |",
        "| fuzzy-4 | another | cases | nothing | all | one |",
        f"| silent |{5 * ' not declared |'}",
    ]
    found = json.loads(printed(capsys, "leaderboard", path, "--json"))
    assert [one["declared"] for one in found["standings"]] == list(content["declared"].values())
    ranks = [(one["rank"], one["policy"], one["score"]["mean"]) for one in found["standings"]]
    assert ranks == [(1, "mine", 2.0), (2, "fuzzy-4", 4.0), (3, "silent", 6.0)]
    assert found["conditions"] == "fuzzyarm 0.1.0, control period 1 ms, 1 seed, encoder noise 1e-05 rad and 0.001 rad/s"


@pytest.mark.parametrize(
    ("values", "mean"),
    [
        ([7.0], 7.0),
        ([1.0, 4.0], 2.5),
        ([1.0, 2.0, 9.0], 4.0),  # a quarter of three is no whole run
        ([9.0, 1.0, 3.0, 2.0], 2.5),
        ([100.0, 1.0, 2.0, 4.0, 6.0], 4.0),  # of five the middle three
        ([5.0, 1.0, 2.0, 3.0, 4.0, -90.0, 80.0, 6.0], 3.5),
    ],
)
def test_mean_of_the_middle_half_by_hand(values, mean):
    assert estimate(values).mean == pytest.approx(mean)


@pytest.mark.parametrize("seed", range(5))
def test_interval_is_that_of_all_resamples(seed):
    # Of five values there are 5⁵ resamples: their percentiles need no random draws.
    values = np.random.default_rng(seed).lognormal(size=5)
    resamples = values[np.array(list(itertools.product(range(5), repeat=5)))]
    exact = np.percentile(trim_mean(resamples, 0.25, axis=1), [2.5, 97.5])
    found = estimate(values)
    assert values.min() <= found.low <= found.mean <= found.high <= values.max()
    assert [found.low, found.high] == pytest.approx(exact, abs=0.03 * np.ptp(values))
    assert estimate(values[::-1]).mean == pytest.approx(found.mean)
    assert estimate(values) == found


def test_one_run_has_no_interval_and_equal_runs_an_empty_one():
    assert estimate([0.3]) == (0.3, None, None)
    assert estimate([0.3] * 5) == pytest.approx((0.3, 0.3, 0.3))
