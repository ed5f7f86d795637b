"""What several runs of one training, which differ by their seed, come to: a middle value and how far it can be trusted.

The interquartile mean of n values is the mean without the ⌊n/4⌋ smallest and the ⌊n/4⌋ largest: of five values that of
the middle three. One run that went wrong does not move it, and it uses more of the runs than the median does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap, trim_mean

LEVEL = 0.95
RESAMPLES = 9999
SEED = 0  # of the resampling: the same values give the same interval


class Estimate(NamedTuple):
    """A mean and the interval for it, in the unit of the values; both ends None where there is no interval."""

    mean: float
    low: float | None
    high: float | None


def interquartile_mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the mean along an axis without the ⌊n/4⌋ smallest and the ⌊n/4⌋ largest of n values."""
    return np.asarray(trim_mean(values, 0.25, axis=axis))


def estimate(values: Sequence[float]) -> Estimate:
    """Return the interquartile mean of some runs, with a bootstrap interval of 95 % if there are two or more.

    The interval holds the 2.5 % to 97.5 % percentiles of the means of `RESAMPLES` samples drawn with replacement. It
    speaks of the training, not of these runs alone, but with five runs it is somewhat narrow: of normal or log-normal
    values it covers the true interquartile mean in about nine samples of ten.

    Args:
        values: one number per run.

    Raises:
        ValueError: there are no values, or one is not finite; the message says what to do.
    """
    numbers = np.asarray(values, dtype=float)
    if numbers.ndim != 1 or not len(numbers) or not np.isfinite(numbers).all():
        raise ValueError(f"values = {list(values)} must be one or more finite numbers; count runs without one apart")
    mean = float(interquartile_mean(numbers))
    if len(numbers) == 1:
        return Estimate(mean, None, None)
    # Percentiles: the corrections of the default method are undefined for equal values.
    found = bootstrap(
        (numbers,),
        interquartile_mean,
        n_resamples=RESAMPLES,
        confidence_level=LEVEL,
        method="percentile",
        rng=np.random.default_rng(SEED),
    ).confidence_interval
    return Estimate(mean, float(found.low), float(found.high))
