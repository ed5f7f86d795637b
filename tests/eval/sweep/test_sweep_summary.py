"""Quantiles and intervals over plants, the table, the cells of a map, and the ranking of policies."""

import json
import math
import re

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import binom, binomtest
from support.command_line import printed, refused

from fuzzyarm.eval.evaluation.ranking import markdown
from fuzzyarm.eval.sweep._distributions import columns_of, plant_record
from fuzzyarm.eval.sweep._episodes import SweepResults
from fuzzyarm.eval.sweep._figures import _Cells
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.ranking import rank_sweeps
from fuzzyarm.eval.sweep.summary import _QUANTILES, _quantile_ranks, _quantiles, _worst, print_sweep, summarise


@pytest.mark.parametrize("count", [2, 15, 400, 5000])
def test_the_intervals_of_quantiles_are_those_of_infinitely_many_resamples(count):
    """Rank r or below is the quantile k of a resample if at least k + 1 of its n draws are: a binomial tail."""
    ranks, low, high = _quantile_ranks(count)
    for p, rank, first, last in zip(_QUANTILES, ranks, low, high, strict=True):
        assert rank == sum((i + 1) < p * count - 1e-9 for i in range(count))
        tail = binom.sf(rank, count, (np.arange(count) + 1.0) / count)
        slack = 4 * math.sqrt(0.025 * 0.975 / 2000)  # four standard errors of a share of 2000 resamples
        assert tail[first] > 0.025 - slack and (first == 0 or tail[first - 1] < 0.025 + slack)
        assert tail[last] > 0.975 - slack and (last == 0 or tail[last - 1] < 0.975 + slack)


def test_the_quantiles_of_values_are_values_of_that_rank_and_beyond_every_bound_among_episodes_that_ended_early():
    values = np.random.default_rng(1).permutation(np.append(np.arange(920.0), np.full(80, np.inf)))
    for (p, found), *ranks in zip(_quantiles(values).items(), *_quantile_ranks(1000), strict=True):
        assert list(found.values()) == [float(rank) if rank < 920 else None for rank in ranks]
        assert (found["value"] is None) == (p == "0.99")


def results_of(config, errors, completed=None, plants=None):
    completed = np.ones(errors.shape, bool) if completed is None else completed
    plants = np.zeros(config.total, plant_record(2)) if plants is None else plants
    metrics = {"max_mm": errors, "rms_mm": 0.5 * errors}
    return SweepResults(plants, metrics, seconds=np.full(errors.shape, 1.5), completed=completed)


def made(count=200):
    generator = np.random.default_rng(3)
    config = SweepConfig(policies=("fuzzy-4",), cases=("nominal", "payload"), plants=count, bound=10.0, worst=3, seed=7)
    plants = generator.uniform(size=(count, len(columns_of(2)))).view(plant_record(2))[:, 0]
    results = results_of(config, generator.uniform(1.0, 20.0, (1, 2, count)), plants=plants)
    results.completed[0, 1, [4, 9]] = False
    results.seconds[0, 1, [4, 9]] = 0.7, 0.2
    results.metrics["max_mm"][0, 1, [4, 9]] = 2.0, 3.0  # small, but not to the end
    return config, results


def test_success_counts_plants_below_the_bound_with_wilsons_interval():
    config, results = made()
    row = summarise(config, results)["rows"][1]
    successes = sum((results.metrics["max_mm"][0, 1] < 10.0) & results.completed[0, 1])
    low, high = binomtest(successes, 200).proportion_ci(method="wilson")
    assert row["success"] == pytest.approx({"value": successes / 200, "low": low, "high": high})
    assert row["ended_early"] == 2


def test_the_worst_plants_come_with_what_makes_them():
    config, results = made()
    first, second = summarise(config, results)["rows"]
    assert [one["plant"] for one in second["worst"]][:2] == [9, 4]  # the earliest end first
    order = np.argsort(results.metrics["max_mm"][0, 0])[::-1][:3]
    assert [one["plant"] for one in first["worst"]] == order.tolist()
    for one in first["worst"]:
        assert one["seed"] == 7 + one["plant"]
        own = zip(columns_of(2), results.plants[one["plant"]].tolist(), strict=True)
        assert list(one["parameters"].items()) == list(own)
        assert one["max_mm"] == results.metrics["max_mm"][0, 0, one["plant"]]
    assert len(_worst(results.episodes(0, 0), 0)) == 0


def test_the_table_shows_no_number_without_its_interval():
    config, results = made(5000)
    results.metrics["max_mm"][0, 0] = 1.0  # all succeed
    with (console := Console(width=250)).capture() as captured:
        print_sweep(summarise(config, results), console)
    lines = [line for line in captured.get().splitlines() if line.startswith("fuzzy-4")]
    assert len(lines) == 2 and all(len(re.findall(r"[\d.]+ \([\d.]+ to [\d.]+\)", line)) == 5 for line in lines)
    assert "100.00 (99.92 to 100.00)" in lines[0]  # Wilson: n/(n + z²) of 5000


def test_the_cells_of_a_grid_hold_the_medians_of_their_plants():
    grid = (("stiffness", 0.5, 1.5, 5), ("delay", 0, 3, 4))
    config = SweepConfig(policies=("fuzzy-4",), cases=("nominal",), distribution="plants", plants=3, grid=grid)
    plants, (stiffness, delay) = np.zeros(config.total, dtype=plant_record(2)), config.grid
    plants["stiffness_1"] = np.repeat(stiffness.values, 4 * 3)
    plants["delay"] = np.tile(np.repeat(delay.values, 3), 5)
    errors = np.random.default_rng(0).lognormal(2.5, 1.0, config.total)
    cells = _Cells.of(config, plants)
    assert np.array_equal(cells.medians(errors), np.median(errors.reshape(5, 4, 3), axis=-1).T)
    np.testing.assert_allclose(np.concatenate(cells.edges), [*np.arange(0.375, 1.7, 0.25), *np.arange(-0.5, 4.0)])


PLANTS = 200


def document(errors, completed=None, **config):
    """The document of a sweep for largest errors (policies, cases, plants) [mm] of fuzzy-1, fuzzy-2, ..."""
    policies = tuple(f"fuzzy-{k}" for k in (1, 2, 4)[: len(errors)])
    whole = SweepConfig(policies=policies, cases=("nominal", "payload"), plants=errors.shape[-1], **config)
    return summarise(whole, results_of(whole, errors, completed))


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


def test_sweeps_of_other_plants_are_ranked_together(write, capsys):
    one, more = write("a", document(drawn(2))), write("b", document(3.0 * drawn(1, 1), seed=500))
    assert printed(capsys, "leaderboard", one.parent, more, "--markdown").count("fuzzy-1") == 2


def test_what_cannot_be_ranked_is_refused_in_one_line(write, tmp_path, capsys):
    path = write("a", document(drawn(1)))
    damaged = json.loads(path.read_text())
    del damaged["rows"][0]["max_mm"]
    results = tmp_path / "results.json"
    results.write_text("{}")
    for words, message in (
        ([path, path.parent], "given twice"),
        ([path, results], "rank sweeps and evaluations separately"),
        ([path, "--bound", results], "leave out --bound"),
        ([path, write("b", document(drawn(1), distribution="all"))], "not comparable: distribution"),
        ([write("c", damaged)], "damaged ('max_mm' is missing)"),
        ([write("d", damaged | {"schema": "fuzzyarm-sweep/1"})], "fuzzyarm-sweep/1"),
    ):
        assert message in refused(capsys, "leaderboard", *words)
