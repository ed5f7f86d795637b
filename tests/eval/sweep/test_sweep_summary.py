import math
import re

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import binom, norm

from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.distributions import columns_of, plant_record
from fuzzyarm.eval.sweep.episodes import SweepResults
from fuzzyarm.eval.sweep.summary import QUANTILES, print_sweep, quantile_ranks, quantiles, summarise, worst


@pytest.mark.parametrize("count", [2, 15, 400, 5000])
def test_the_intervals_of_quantiles_are_those_of_infinitely_many_resamples(count):
    """Rank r or below is the quantile k of a resample if at least k + 1 of its n draws are: a binomial tail."""
    ranks, low, high = quantile_ranks(count)
    for p, rank, first, last in zip(QUANTILES, ranks, low, high, strict=True):
        assert rank == sum((i + 1) < p * count - 1e-9 for i in range(count))
        tail = binom.sf(rank, count, (np.arange(count) + 1.0) / count)
        slack = 4 * math.sqrt(0.025 * 0.975 / 2000)  # four standard errors of a share of 2000 resamples
        assert tail[first] > 0.025 - slack and (first == 0 or tail[first - 1] < 0.025 + slack)
        assert tail[last] > 0.975 - slack and (last == 0 or tail[last - 1] < 0.975 + slack)


def test_the_quantiles_of_values_are_values_of_that_rank_in_any_order():
    values = np.random.default_rng(1).permutation(np.arange(1000.0)) ** 3
    ranks, low, high = quantile_ranks(1000)
    for found, *expected in zip(quantiles(values).values(), ranks, low, high, strict=True):
        assert list(found.values()) == [float(rank) ** 3 for rank in expected]


def test_a_quantile_among_episodes_that_ended_early_is_beyond_every_bound():
    values = np.concatenate([np.arange(92.0), np.full(8, np.inf)])
    found = quantiles(values)
    assert found["0.5"]["value"] == 49.0
    assert found["0.9"]["value"] == 89.0 and found["0.9"]["high"] is None
    assert found["0.99"]["value"] is None and found["0.99"]["high"] is None


def made(count=200):
    generator = np.random.default_rng(3)
    config = SweepConfig(policies=("fuzzy-4",), cases=("nominal", "payload"), plants=count, bound=10.0, worst=3, seed=7)
    shape = 1, 2, count
    plants = np.empty(count, dtype=plant_record(2))
    for name in columns_of(2):
        plants[name] = generator.uniform(size=count)
    results = SweepResults(
        plants,
        {"max_mm": generator.uniform(1.0, 20.0, shape), "rms_mm": generator.uniform(0.1, 1.0, shape)},
        seconds=np.full(shape, 1.5),
        completed=np.ones(shape, dtype=bool),
    )
    results.completed[0, 1, [4, 9]] = False
    results.seconds[0, 1, [4, 9]] = 0.7, 0.2
    results.metrics["max_mm"][0, 1, [4, 9]] = 2.0, 3.0  # small, but not to the end
    return config, results


def test_success_counts_plants_below_the_bound_with_wilsons_interval():
    config, results = made()
    row = summarise(config, results)["rows"][1]
    n, k = 200, sum((results.metrics["max_mm"][0, 1] < 10.0) & results.completed[0, 1])
    z, share = norm.ppf(0.975), k / n
    center = (share + z * z / (2 * n)) / (1 + z * z / n)
    reach = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    assert row["success"] == pytest.approx({"value": share, "low": center - reach, "high": center + reach})
    assert row["ended_early"] == 2


def test_the_worst_plants_come_with_what_makes_them():
    config, results = made()
    first, second = summarise(config, results)["rows"]
    assert [one["plant"] for one in second["worst"]][:2] == [9, 4]  # the earliest end first
    order = np.argsort(results.metrics["max_mm"][0, 0])[::-1][:3]
    assert [one["plant"] for one in first["worst"]] == order.tolist()
    for one in first["worst"]:
        assert one["seed"] == 7 + one["plant"]
        assert list(one["parameters"].items()) == list(
            zip(columns_of(2), results.plants[one["plant"]].tolist(), strict=True)
        )
        assert one["max_mm"] == results.metrics["max_mm"][0, 0, one["plant"]]
    assert len(worst(results.episodes(0, 0), 0)) == 0


def test_the_table_shows_no_number_without_its_interval():
    config, results = made(5000)
    results.metrics["max_mm"][0, 0] = 1.0  # all succeed
    with (console := Console(width=250)).capture() as captured:
        print_sweep(summarise(config, results), console)
    lines = [line for line in captured.get().splitlines() if line.startswith("fuzzy-4")]
    assert len(lines) == 2 and all(len(re.findall(r"[\d.]+ \([\d.]+ to [\d.]+\)", line)) == 5 for line in lines)
    assert "100.00 (99.92 to 100.00)" in lines[0]  # Wilson: n/(n + z²) of 5000
