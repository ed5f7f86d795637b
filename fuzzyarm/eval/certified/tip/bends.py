"""Functions of one number that rise, taken as lines with a rest, on a range: tanh, asinh and the clip of a network.

    |f(x) - f_m - λ (x - z)| <= rest        for |x - z| <= r.

Two lines are known, and the one with the smaller rest is taken. With λ the smallest f' of the range, f(x) - λ x does
not fall, so it lies between its values at both ends. And with λ = f'(z), rest = sup|f''| r²/2 (Taylor).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from flint import arb

from fuzzyarm.eval.certified.tip.enclosures import ROUND_UP, ball, centre, low_high, radius_of
from fuzzyarm.eval.certified.tip.forms import Forms

__all__ = ["ASINH", "STRAIGHT", "TANH", "Bend", "Clip", "Line", "Smooth", "append_bent"]


class Line(NamedTuple):
    """A line: f_m, λ and the rest; f_m a ball."""

    value: Any
    slope: float
    rest: float


class Bend(Protocol):
    """A function that rises."""

    def line(self, z: arb, r: float) -> Line:
        """Return a line for |x - z| <= r."""
        ...


@dataclasses.dataclass(frozen=True)
class Smooth:
    """A function whose derivative is even and falls with |x|.

    Attributes:
        value: f.
        rate: f', of |x|.
        bend: bound of |f''| everywhere.
    """

    value: Callable[[arb], arb]
    rate: Callable[[arb], arb]
    bend: float

    def line(self, z: arb, r: float) -> Line:
        """Return the better of the module's two lines."""
        f, slope = self.value(z), self.rate(z)
        tangent = centre(slope)
        taylor = (0.5 * self.bend * r * r + radius_of(slope, tangent) * r) * ROUND_UP
        low, high = low_high(z + ball(0.0, r))
        least = low_high(self.rate(arb(max(abs(low), abs(high)))))[0]
        ends = (self.value(arb(end)) - least * arb(end) for end in (low, high))
        between = least * z + next(ends).union(next(ends))
        middle = centre(between)
        if radius_of(between, middle) < taylor:
            return Line(arb(middle), least, radius_of(between, middle))
        return Line(f, tangent, taylor)


@dataclasses.dataclass(frozen=True)
class Clip:
    """min(max(x, -c), c).

    Attributes:
        most: c > 0; None: no clip.
    """

    most: float | None

    def line(self, z: arb, r: float) -> Line:
        """Return the line of slope 1 or 0 where there is no corner in the range, else the one of slope 0."""
        low, high = low_high(z + ball(0.0, r))
        if self.most is None or (-self.most < low and high < self.most):
            return Line(z, 1.0, 0.0)
        low, high = (min(max(end, -self.most), self.most) for end in (low, high))
        return Line(arb(0.5 * (low + high)), 0.0, 0.5 * (high - low) * ROUND_UP)


TANH = Smooth(arb.tanh, lambda x: 1 - x.tanh() ** 2, 0.77)
"""|f''| = 2 h (1 - h²) <= 4/(3 √3) = 0.7699, h = tanh x."""
ASINH = Smooth(arb.asinh, lambda x: 1 / (1 + x * x).sqrt(), 0.386)
"""|f''| = x/(1 + x²)^(3/2) <= 2/(3 √3) = 0.3850, rounded up."""
STRAIGHT = Clip(None)
"""f(x) = x, for what has no limit."""


def append_bent(forms: Forms, rows: np.ndarray, at: list[Any], bends: Sequence[Bend]) -> None:
    """Append f(x) to numbers, for x = `at` + `rows` times their deviations (n, numbers), one f for each x."""
    spread = forms.spread(rows)
    lines = [bend.line(z, r) for bend, z, r in zip(bends, at, spread.tolist(), strict=True)]
    slopes, rests = np.array([line.slope for line in lines]), np.array([line.rest for line in lines])
    forms.extend(slopes[:, np.newaxis] * rows, [line.value for line in lines], 0.0 * rests, np.diag(rests))
