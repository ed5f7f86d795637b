"""Bisection, directed rounding to decimal numbers, and consecutive slices.

A float stands for the shortest decimal number that identifies it, its `repr`, as in a certificate. Rounding
this decimal is exact.
"""

import math
from collections.abc import Callable
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from typing import SupportsFloat

__all__ = ["at_least", "at_most", "consecutive", "last_that_works"]


def last_that_works(
    works: Callable[[float], bool], good: float, bad: float, *, resolution: float, limit: float | None = None
) -> float | None:
    """Return a number that works, within a relative `resolution` of the first that does not.

    The search moves from `good` towards `bad`, both positive, in geometric steps: first by the factor bad/good until a
    number fails, then by bisection between the last number that works and the first that fails.
    `works` is never evaluated at `good`, which is assumed to work. The search gives up beyond `limit` and returns None;
    without a limit, `bad` is assumed to fail and is not evaluated.
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


def at_most(value: SupportsFloat, digits: int) -> str:
    """Return `value` rounded up to `digits` significant digits, as text that may follow "at most".

    Examples:
        >>> at_most(158.484, 3), at_most(20.0, 3), at_most(2.0049e-4, 3)
        ('159', '20', '0.000201')
    """
    return _rounded(value, digits, ROUND_CEILING)


def at_least(value: SupportsFloat, digits: int) -> str:
    """Return `value` rounded down to `digits` significant digits, as text that may follow "at least".

    Examples:
        >>> at_least(19.999, 3), at_least(-1.2345, 3)
        ('19.9', '-1.24')
    """
    return _rounded(value, digits, ROUND_FLOOR)


def _rounded(value: SupportsFloat, digits: int, rounding: str) -> str:
    exact = Decimal(repr(float(value)))
    if not exact.is_finite():
        raise ValueError(f"cannot state a bound: {value} is not a finite number")
    if not exact:
        return "0"
    rounded = exact.quantize(Decimal((0, (1,), exact.adjusted() - digits + 1)), rounding=rounding).normalize()
    return f"{rounded:f}" if -5 < rounded.adjusted() < 16 else f"{rounded:e}"


def consecutive(*sizes: int) -> list[slice]:
    """Return adjacent slices of these lengths, the first of which begins at 0.

    >>> consecutive(2, 1)
    [slice(0, 2, None), slice(2, 3, None)]
    """
    slices, start = [], 0
    for size in sizes:
        slices.append(slice(start, start + size))
        start += size
    return slices
