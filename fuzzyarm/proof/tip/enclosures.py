"""Enclosures of numbers: balls, forward derivatives on balls, and sums of floats rounded upwards.

    x in ball(c, r)  means  |x - c| <= r.          |fl(X Y) - X Y| <= SLACK |X| |Y|   for matrices of floats.

Balls are FLINT's `arb`, whose operations enclose every rounding error. Long matrix products are computed in floats
instead: the error of a product of n terms is at most n u/(1 - n u) times the product of the absolute values, u = 2^-53,
for any order of summation. `SLACK` = 2^-40 exceeds that bound for a chain of 2^12 operations.
"""

from __future__ import annotations

import math
from typing import Any

from flint import arb

__all__ = [
    "BITS", "ROUND_UP", "SLACK", "Jet", "NoBound", "between", "largest", "low_high", "middle_of", "radius_of",
]  # fmt: skip

BITS = 80  # precision of the balls: K (θ - q) loses seven digits of a double
SLACK = 2.0**-40
"""Relative allowance for rounding; see the module."""

ROUND_UP = 1.0 + SLACK  # a sum of non-negative floats, times this, is not below the exact sum
_TINY = 1e-300  # largest loss by underflow


class NoBound(ValueError):
    """There is no bound; the message gives the reason in one line."""


def between(low: float, high: float) -> arb:
    """Return a ball that encloses [low, high]."""
    middle = 0.5 * (low + high)
    return arb(middle, (max(high - middle, middle - low)) * ROUND_UP + _TINY)


def middle_of(x: Any) -> float:
    """Return a float near the middle of a ball; ValueError if the ball is not finite."""
    value = float(x.mid())
    if not math.isfinite(value) or not x.is_finite():
        raise ValueError("no finite enclosure was found for a number in the proof")
    return value


def radius_of(x: Any, about: float) -> float:
    """Return an upper bound on |x - about| for all points of the ball x."""
    return float((x - about).abs_upper()) * ROUND_UP + _TINY


def largest(x: Any) -> float:
    """Return an upper bound on |x| for all points of the ball x."""
    return float(x.abs_upper()) * ROUND_UP + _TINY


def low_high(x: Any) -> tuple[float, float]:
    """Return a lower and an upper float bound on a ball."""
    middle = middle_of(x)
    radius = radius_of(x, middle)
    return middle - radius * ROUND_UP - SLACK * abs(middle), middle + radius * ROUND_UP + SLACK * abs(middle)


class Jet:
    """A value and its partial derivatives by variable; a variable without an entry has the derivative zero.

    Value and derivatives are of any number type. Evaluated on balls, the derivatives enclose those at every point of
    the box that the balls span, so that the mean value theorem applies.
    """

    __slots__ = ("slopes", "value")

    def __init__(self, value: Any, slopes: dict[int, Any]) -> None:
        self.value, self.slopes = value, slopes

    @classmethod
    def variable(cls, value: Any, index: int) -> Jet:
        """Return the jet of the variable `index`: its value, and the derivative 1 with respect to itself."""
        return cls(value, {index: arb(1)})

    def slope(self, index: int) -> Any:
        """Return the derivative with respect to the variable with this index."""
        return self.slopes.get(index, arb(0))

    def _scaled(self, factor: Any) -> dict[int, Any]:
        return {index: slope * factor for index, slope in self.slopes.items()}

    def __add__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value + other, self.slopes)
        slopes = dict(self.slopes)
        for index, slope in other.slopes.items():
            slopes[index] = slopes[index] + slope if index in slopes else slope
        return Jet(self.value + other.value, slopes)

    __radd__ = __add__

    def __neg__(self) -> Jet:
        return Jet(-self.value, {index: -slope for index, slope in self.slopes.items()})

    def __sub__(self, other: Any) -> Jet:
        return self.__add__(-other)

    def __rsub__(self, other: Any) -> Jet:
        return self.__neg__().__add__(other)

    def __mul__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value * other, self._scaled(other))
        slopes = self._scaled(other.value)
        for index, slope in other.slopes.items():
            product = slope * self.value
            slopes[index] = slopes[index] + product if index in slopes else product
        return Jet(self.value * other.value, slopes)

    __rmul__ = __mul__

    def sin(self) -> Jet:
        """Return the jet of the sine of this jet."""
        return Jet(self.value.sin(), self._scaled(self.value.cos()))

    def exp(self) -> Jet:
        """Return the jet of the exponential of this jet."""
        return Jet(self.value.exp(), self._scaled(self.value.exp()))

    def cos(self) -> Jet:
        """Return the jet of the cosine of this jet."""
        return Jet(self.value.cos(), self._scaled(-self.value.sin()))
