"""Numbers in texts that state a bound: rounded so that the statement still holds.

    at_most(2.0049e-4, 3) = "0.000201"        at_least(19.999, 3) = "19.9"

A float is read as the shortest decimal number that identifies it, its `repr`, which is also what a certificate proves
(`proof.certificate`). Rounding that decimal is exact.
"""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from typing import SupportsFloat

__all__ = ["at_least", "at_most"]


def at_most(value: SupportsFloat, digits: int) -> str:
    """Return a number of `digits` significant digits that is not below `value`: what "at most" is followed by.

    Raises:
        ValueError: the value is not finite.

    Examples:
        >>> at_most(158.484, 3), at_most(20.0, 3), at_most(2.0049e-4, 3)
        ('159', '20', '0.000201')
    """
    return _rounded(value, digits, ROUND_CEILING)


def at_least(value: SupportsFloat, digits: int) -> str:
    """Return a number of `digits` significant digits that is not above `value`: what "at least" is followed by.

    Raises:
        ValueError: the value is not finite.

    Examples:
        >>> at_least(19.999, 3), at_least(-1.2345, 3)
        ('19.9', '-1.24')
    """
    return _rounded(value, digits, ROUND_FLOOR)


def _rounded(value: SupportsFloat, digits: int, rounding: str) -> str:
    exact = Decimal(repr(float(value)))
    if not exact.is_finite():
        raise ValueError(f"{value} is not finite: there is no bound to state")
    if not exact:
        return "0"
    rounded = exact.quantize(Decimal((0, (1,), exact.adjusted() - digits + 1)), rounding=rounding).normalize()
    return f"{rounded:f}" if -5 < rounded.adjusted() < 16 else f"{rounded:e}"
