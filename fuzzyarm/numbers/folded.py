"""Numbers among which some are known beforehand: with these nothing is computed, and signs are kept apart.

General algorithms multiply by zeros and ones of a particular robot: entries of a rotation, the height of a planar arm.
They are plain floats there, and what is not known is `Folded`. Then 0 x is 0, 0 + x and 1 x are x, and (-x) y, x + (-y)
and -(x - y) are -(x y), x - y and y - x, which is exact, in whichever kind of number x and y are.
"""

from __future__ import annotations

from typing import Any

__all__ = ["Folded", "unfolded"]


class Folded:
    """A number that is not known beforehand, or its negative; arithmetic takes others of its class, and floats."""

    __slots__ = ("negative", "value")

    def __init__(self, value: Any, negative: bool = False) -> None:
        self.value, self.negative = value, negative

    def __neg__(self) -> Folded:
        return Folded(self.value, not self.negative)

    def __add__(self, other: Any) -> Folded:
        if not isinstance(other, Folded):
            return self if other == 0.0 else Folded(unfolded(self) + other)
        if self.negative == other.negative:
            return Folded(self.value + other.value, self.negative)
        return Folded(other.value - self.value if self.negative else self.value - other.value)

    def __sub__(self, other: Any) -> Folded:
        return self.__add__(-other)

    def __rsub__(self, other: float) -> Folded:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Folded):
            return Folded(self.value * other.value, self.negative != other.negative)
        if other in (0.0, 1.0, -1.0):
            return 0.0 if other == 0.0 else Folded(self.value, self.negative != (other < 0.0))
        return Folded(self.value * other, self.negative)

    def __rtruediv__(self, other: float) -> Folded:
        return Folded(other / self.value, self.negative)

    __radd__, __rmul__ = __add__, __mul__


def unfolded(number: Any) -> Any:
    """Return a number of `Folded` as it was before; a float as it is."""
    if isinstance(number, Folded):
        return -number.value if number.negative else number.value
    return number
