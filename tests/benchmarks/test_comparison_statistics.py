"""The statistics of the comparison of all policies, against slower or analytical oracles."""

import comparison_statistics as statistics
import numpy as np
import pytest
from scipy.stats.mstats import trimmed_mean_ci


@pytest.fixture(scope="module")
def errors():
    """Return the errors of 1,000 plants [mm], with a long tail."""
    return np.random.default_rng(7).lognormal(0.0, 0.8, 1000)


def test_the_score_is_the_mean_of_the_middle_half_with_the_interval_of_a_trimmed_mean(errors):
    found = statistics.score(errors, [])
    assert found["mean"] == pytest.approx(sorted(errors)[250:750] @ np.full(500, 1 / 500), rel=1e-12)
    low, high = trimmed_mean_ci(errors, limits=(0.25, 0.25), alpha=0.05)  # Tukey and McLaughlin's, from the variance
    assert found["high"] - found["low"] == pytest.approx(high - low, rel=0.15)
    assert (found["low"], found["high"]) == pytest.approx((low, high), abs=0.15 * (high - low))


def test_the_lost_count_as_the_largest_errors(errors):
    lost, finite = errors.copy(), errors.copy()
    worst = np.argsort(errors)[-100:]
    lost[worst], finite[worst] = np.inf, 1e3
    assert statistics.score(lost, []) == pytest.approx(statistics.score(finite, []), rel=1e-12)


@pytest.mark.parametrize(("share", "ends"), [(0.24, (True, False)), (0.26, (False, False))])
def test_a_score_into_which_lost_plants_reach_has_no_number(errors, share, ends):
    lost = errors.copy()
    lost[: round(share * len(lost))] = np.inf
    found = statistics.score(lost, [])
    assert (found["low"] is not None, found["high"] is not None) == ends
    assert (found["mean"] is None) == (found["low"] is None)


def test_over_seeds_the_score_is_that_of_the_seeds(errors):
    seeds = [factor * errors for factor in (1.0, 2.0, 3.0, 4.0, 100.0)]
    found, one = statistics.score(errors, seeds), statistics.score(errors, [])["mean"]
    assert found["mean"] == pytest.approx(3.0 * one)  # of the middle three
    assert one <= found["low"] < found["mean"] < found["high"] <= 100.0 * one
    assert statistics.score(errors, [*seeds[:4], np.full(len(errors), np.inf)])["mean"] is None


def test_policies_whose_intervals_overlap_share_a_rank():
    ends = {"a": (0.0, 1.0), "b": (1.0, 3.0), "c": (1.5, 2.0), "d": (3.5, None), "e": (9.0, 9.5), "f": (None, None)}
    found = statistics.ranks_of({name: {"low": low, "high": high} for name, (low, high) in ends.items()})
    assert found == {"a": 1, "b": 1, "c": 2, "d": 4, "e": 4, "f": 5}
