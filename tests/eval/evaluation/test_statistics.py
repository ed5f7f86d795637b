"""Means and intervals of a few runs, compared with results by hand and with the set of all resamples."""

import itertools

import numpy as np
import pytest
from scipy.stats import trim_mean

from fuzzyarm.eval.evaluation.statistics import estimate


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
    assert found.low <= found.mean <= found.high
    assert [found.low, found.high] == pytest.approx(exact, abs=0.03 * np.ptp(values))
    assert values.min() <= found.low
    assert found.high <= values.max()
    assert estimate(values[::-1]).mean == pytest.approx(found.mean)
    assert estimate(values) == found


def test_one_run_has_no_interval_and_equal_runs_an_empty_one():
    assert estimate([0.3]) == (0.3, None, None)
    assert estimate([0.3] * 5) == pytest.approx((0.3, 0.3, 0.3))


@pytest.mark.parametrize("values", [[], [1.0, float("nan")], [1.0, float("inf")]])
def test_what_is_no_number_is_refused(values):
    with pytest.raises(ValueError, match="one or more finite numbers"):
        estimate(values)
