"""Bisection: the last positive number for which a condition holds."""

from __future__ import annotations

import math
from collections.abc import Callable

__all__ = ["last_that_works"]


def last_that_works(
    works: Callable[[float], bool], good: float, bad: float, *, resolution: float, limit: float | None = None
) -> float | None:
    """Return a number that works, within a relative `resolution` of the first that does not.

    From `good` towards `bad`, both positive, in geometric steps: first by the factor bad/good until something fails,
    then by bisection between the last that works and the first that fails.

    Args:
        works: the condition; evaluated at `bad` and beyond, never at `good`, which is assumed to work.
        good: a number that works.
        bad: the first number tried; bad/good is the factor between the numbers tried next.
        resolution: of the result, relative, positive.
        limit: where the search gives up; None: `bad` is known to fail and is not tried.

    Returns:
        The last number found to work; None if everything works up to `limit`.
    """
    ratio = bad / good
    if limit is not None:
        while works(bad):
            good, bad = bad, bad * ratio
            if (bad - limit) * (ratio - 1.0) > 0.0:
                return None
    while max(good, bad) > min(good, bad) * (1.0 + resolution):
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if works(middle) else (good, middle)
    return good
