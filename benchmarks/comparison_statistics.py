"""Scores and ranks of `comparison.py`, from errors of policies on the same plants."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from fuzzyarm.eval.evaluation._statistics import LEVEL, estimate, interquartile_mean

__all__ = ["ranks_of", "score"]

_RESAMPLES = 999
_LOST, _LARGEST = 1e12, 1e6  # mm: stands for the error of an episode that ended early; no mean without one is as large

Score = dict[str, float | None]


def score(errors: np.ndarray, by_seed: Sequence[np.ndarray]) -> Score:
    """Return the interquartile mean of errors (plants,) [mm] and its interval, over seeds if there are several.

    An error is inf where the episode ended early. The mean is None, and so is an end of the interval, where the middle
    half of the plants has such an episode.
    """
    if len(by_seed) > 1:
        means = [_score_of(one) for one in by_seed]
        return _NONE if None in means else estimate([mean for mean in means if mean is not None])._asdict()
    mean = _score_of(errors)
    if mean is None:
        return _NONE
    low, high = _interval(np.where(np.isinf(errors), _LOST, errors), interquartile_mean)
    return {"mean": mean, "low": low, "high": high if high < _LARGEST else None}


_NONE: Score = {"mean": None, "low": None, "high": None}


def ranks_of(scores: Mapping[str, Score]) -> dict[str, int]:
    """Return the ranks from 1, by policy: one more than the number of intervals that lie wholly below its own.

    A policy without a score is behind all that have one.
    """
    low, high = (
        {name: math.inf if one[end] is None else one[end] for name, one in scores.items()} for end in ("low", "high")
    )
    return {name: 1 + sum(high[other] < low[name] for other in scores) for name in scores}


def _score_of(errors: np.ndarray) -> float | None:
    """Return the interquartile mean of errors (plants,) [mm]; None where it is infinite."""
    mean = float(interquartile_mean(np.where(np.isinf(errors), _LOST, errors)))
    return mean if mean < _LARGEST else None


def _interval(values: np.ndarray, statistic: Callable[..., Any]) -> tuple[float, float]:
    """Return the ends of the bootstrap interval of a statistic of values (plants,)."""
    found = bootstrap(
        (values,),
        statistic,
        n_resamples=_RESAMPLES,
        batch=50,
        method="percentile",
        confidence_level=LEVEL,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)
