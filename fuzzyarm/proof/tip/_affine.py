"""Affine numbers: a law evaluated on them covers all points of a zonotope at once.

    x = c + r (ξ, g) + β,      ξ the deviations of a zonotope,   |g_i| <= 1,   |β| <= rest.

x is the float computed on the robot: each operation adds its largest rounding error to `rest`. The deviation of a
product or a function from its linear approximation becomes a new unknown g_i, so that results that depend on g_i stay
correlated; a small deviation is added to `rest`. A product is

    x y = c_x c_y + c_x δy + c_y δx + δx δy,

and a function f is approximated by a line for |x - c| <= d (Taylor's theorem),

    f(x) - f(c) - f'(c) (x - c)  in  [a, b] d²/2      for f'' in [a, b], a <= 0 <= b.

A maximum is approximated by the line through its end values; for `stick_slip` see `_stick_slip`. If several rows of a
table are possible, the law is evaluated for each, see `_Places`. Any other undecided choice raises `NoBound`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from flint import arb

from fuzzyarm.envs.physics import elementwise, friction
from fuzzyarm.fuzzy_policy.laws.learned import network
from fuzzyarm.numbers.functions import KINDS, row, select
from fuzzyarm.proof.tip.enclosures import ROUND_UP, NoBound, between, low_high, middle_of, radius_of
from fuzzyarm.proof.tip.zonotope import Zonotope, reach

__all__ = ["WORTH", "Affine", "Space"]

_ROUND = 2.0**-50  # relative rounding error of an operation, in the law or on a middle or a row here
_UP = 1.0 + 2.0**-46  # covers the rounding of a few operations on bounds
_TINY = 1e-300  # largest loss by underflow
WORTH = 1e-4  # a remainder above this share of the number's size becomes a new unknown
_FARTHEST = 1e3  # largest angle [rad] for which the floats of sine and cosine are trusted


class Space:
    """The variables of affine numbers (deviations and unknowns), and the recorder for a law run on them."""

    def __init__(self, base: Zonotope) -> None:
        self.base, self.unknowns = base, 0  # the zonotope, and the number of unknowns
        self._totals, (self._columns, self._box) = base.totals(), base.condensed()

    def variables(self, point: np.ndarray) -> list[Affine]:
        """Return point (n,) + the zonotope's deviations, as affine numbers."""
        parts = zip(point.tolist(), np.eye(len(point)), self._totals.tolist(), strict=True)
        return [Affine(self, x, row, size, 0.0, size) for x, row, size in parts]

    def number(self, x: Any) -> Affine:
        """Return a float or an affine number as an affine number of this space."""
        return x if isinstance(x, Affine) else Affine(self, float(x), np.zeros(len(self._totals)), 0.0, 0.0)

    def rows(self, numbers: list[Affine]) -> np.ndarray:
        """Return the rows r of several affine numbers as an array (numbers, n), padded with zeros."""
        rows = np.zeros((len(numbers), len(self._totals) + self.unknowns))
        for given, number in zip(rows, numbers, strict=True):
            given[: len(number.row)] = number.row
        return rows

    def reach(self, rows: np.ndarray) -> np.ndarray:
        """Return bounds (m,) on |r (ξ, g)| for the rows r of `rows` (m, n), over all deviations ξ and unknowns g."""
        n, sizes = len(self._totals), np.abs(rows)
        found = reach(rows[:, :n], self._columns) + sizes[:, :n] @ self._box
        return np.asarray((found + sizes[:, n:].sum(axis=1)) * ROUND_UP)

    def reach_of(self, row: np.ndarray) -> float:
        """Return the bound on |r (ξ, g)| for a single row r (n,), faster than `reach`."""
        n, sizes = len(self._totals), np.abs(row)
        found = np.abs(row[:n] @ self._columns).sum() + sizes[:n] @ self._box + sizes[n:].sum()
        return float(found) * ROUND_UP

    def array(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return an empty array of numbers, as `numbers.functions.array` does."""
        return np.empty(shape, dtype=object)

    def each(self, count: int) -> Iterable[int]:
        """Return the indices of a loop, as `numbers.functions.each` does."""
        return range(count)

    def apart(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Return the result of `function` or, for affine arguments, of its substitute in `_ENCLOSED`, if it has one."""
        known = _ENCLOSED.get(function)
        if known is None or not any(isinstance(x, Affine) for x in arguments):
            return function(*arguments)
        return known(*(self.number(x) for x in arguments))

    def rolled(self, name: str, arrays: tuple[Any, ...], _: tuple[bool, ...]) -> None:
        """Add G x to y for the arrays (x, Gᵀ, y) of a loop named `add_product`, for all rows of G at once."""
        assert name == "add_product"
        x, transposed, y = arrays
        y[:] = self._linear(transposed.T, x, y)

    def interpolated(self, table: Any, corners: list[tuple[Any, Any]], sign: float, x: Any, y: Any) -> list[Affine]:
        """Return enclosures of y + sign Σ w_c G_c x for all rows G_c of `table` that corners (row, w_c) may select."""
        found = []
        for number in range(max(len(places.values) if isinstance(places, _Places) else 1 for places, _ in corners)):
            at = [[one.values[number] if isinstance(one, _Places) else one for one in pair] for pair in corners]
            parts = [(np.reshape(row(table, place), (len(y), len(x))), self.number(weight)) for place, weight in at]
            found.append(self._weighted(parts, sign, x, y))
        return [self._joined(each) for each in zip(*found, strict=True)]

    def _weighted(self, parts: list[tuple[np.ndarray, Affine]], sign: float, x: Any, y: Any) -> list[Affine]:
        """Return y + sign Σ w_c G_c x for parts (G_c, w_c).

        The form y + sign ((Σ w_c) G_0 x + Σ w_c (G_c - G_0) x) is almost linear, because Σ w_c hardly varies.
        """
        (first, weight), *others = parts
        sizes = np.array([self.number(one).largest() for one in x])
        terms = sum(w.largest() * (np.abs(G) @ sizes) for G, w in parts)
        factors = [(sum((w for _, w in others), weight), first), *((w, G - first) for G, w in others)]
        grown = [self.number(one) for one in y]
        for factor, G in factors:
            products = self._linear(G, x, [0.0] * len(y))
            grown = [before + sign * factor * product for before, product in zip(grown, products, strict=True)]
        floats = (len(x) + 4 * len(parts)) * _ROUND * np.asarray(terms)
        return [one.widened(left) for one, left in zip(grown, floats.tolist(), strict=True)]

    def _joined(self, numbers: tuple[Affine, ...]) -> Affine:
        """Return an affine number that encloses each of several affine numbers."""
        if len(numbers) == 1:
            return numbers[0]
        rows, size = self.rows(list(numbers)), max(one.size for one in numbers)
        row, middle = rows.mean(axis=0), sum(one.middle for one in numbers) / len(numbers)
        apart = zip(numbers, self.reach(rows - row).tolist(), strict=True)
        rest = max(abs(one.middle - middle) + far + one.rest for one, far in apart) * ROUND_UP
        joined = Affine(self, middle, row, size * _UP, _ROUND * len(numbers) * (abs(middle) + size))
        return joined.widened(rest, fresh=True)

    def _linear(self, G: np.ndarray, x: Any, y: Any) -> list[Affine]:
        """Return G x + y, including the rounding errors of float sums in any order."""
        given, before = ([self.number(one) for one in part] for part in (x, y))
        middles, sizes, rests = np.array([(one.middle, one.size, one.rest) for one in given]).T
        middle, size, rest = np.array([(one.middle, one.size, one.rest) for one in before]).T
        rows, positive = self.rows(before) + G @ self.rows(given), np.abs(G)
        terms = np.abs(middle) + size + positive @ (np.abs(middles) + sizes)
        middle, size = middle + G @ middles, (size + positive @ sizes) * ROUND_UP
        rest = (rest + positive @ rests + (len(given) + 2) * 0.5 * _ROUND * terms) * ROUND_UP + _TINY
        known = (part.tolist() for part in (size, rest, self.reach(rows)))
        return list(map(Affine, [self] * len(rows), middle.tolist(), rows, *known))


class _Line(NamedTuple):
    """A line y + λ (x - z) that approximates f(x): the value y, the slope λ, and a bound on the line's error."""

    value: Any
    slope: float
    rest: float


@dataclasses.dataclass(frozen=True)
class _Bend:
    """A smooth function of one variable, with its first two derivatives."""

    # value, rate, curvature: f, f' and f'' on balls
    value: Callable[[Any], Any]
    rate: Callable[[Any], Any]
    curvature: Callable[[Any], Any]
    floats: float = 0.0  # largest error of f in the law's floats; as a share of |f| if `relative`
    relative: bool = False
    even: bool = False  # f is even and decreases with |x|, which gives its extreme values on a range
    rising: bool = False  # f increases; f' is even and decreases with |x|

    def line(self, z: float, r: float) -> _Line:
        """Return a line that approximates f(x) for |x - z| <= r."""
        at, around = arb(z), arb(z, r)
        f, slope = self.value(at), self.rate(at)
        tangent = middle_of(slope)
        low, high = low_high(self.curvature(around))
        low, high = 0.25 * min(low, 0.0) * r * r, 0.25 * max(high, 0.0) * r * r
        best = _Line(f + (low + high), tangent, ((high - low) + radius_of(slope, tangent) * r) * ROUND_UP)
        far, close = abs(z) + r, max(abs(z) - r, 0.0)
        if self.rising:  # with λ the least f', f - λ x does not decrease: it lies between its end values
            least = low_high(self.rate(arb(far * ROUND_UP)))[0]
            first, last = (self.value(end) - least * (end - at) for end in (at - r, at + r))
            best = min(best, _flat(first.union(last), least), key=lambda line: line.rest)
        if self.even:
            ends = self.value(arb(far * ROUND_UP)).union(self.value(arb(close / ROUND_UP)))
            best = min(best, _flat(ends, 0.0), key=lambda line: line.rest)
        return best


def _flat(values: Any, slope: float) -> _Line:
    """Return a line of slope λ = `slope` for f about z, from a ball `values` that encloses f(x) - λ (x - z)."""
    middle = middle_of(values)
    return _Line(arb(middle), slope, radius_of(values, middle))


def _sinc_rate(x: Any) -> Any:
    """Return sinc'(x) = (cos x - sinc x)/x, at most |x|/3 in magnitude."""
    return (x.cos() - x.sinc()) / x if float(x.abs_lower()) > 1e-6 else between(-1.0, 1.0) * x / 3


def _square(x: Any) -> Any:
    """Return x² on a ball, from the least and the largest |x|."""
    least, most = x.abs_lower(), x.abs_upper()
    return (least * least).union(most * most)


def _one_by(x: Any) -> Any:
    """Return 1/x on a ball of one sign, from the values at both ends."""
    return (1 / x.lower()).union(1 / x.upper())


def _tanh(x: Any) -> Any:
    """Return tanh x on a ball, from the values at both ends."""
    return x.lower().tanh().union(x.upper().tanh())


_SINE = _Bend(arb.sin, arb.cos, lambda x: -x.sin(), 2.0**-46)
_COSINE = _Bend(arb.cos, lambda x: -x.sin(), lambda x: -x.cos(), 2.0**-46)
_SINC = _Bend(arb.sinc, _sinc_rate, lambda x: between(-1.0, 1.0) / 3, 2.0**-46)
_INVERSE = _Bend(_one_by, lambda x: -_square(_one_by(x)), lambda x: 2 * _one_by(x) * _square(_one_by(x)))
_GAUSSIAN = _Bend(
    lambda x: (-_square(x)).exp(), lambda x: -2 * x * (-_square(x)).exp(),
    lambda x: (4 * _square(x) - 2) * (-_square(x)).exp(), 2.0**-44, even=True,
)  # fmt: skip
_TANH = _Bend(
    arb.tanh, lambda x: 1 - _square(_tanh(x)), lambda x: 2 * _tanh(x) * (_square(_tanh(x)) - 1), 2.0**-48,
    relative=True, rising=True,
)  # fmt: skip
_ASINH = _Bend(
    arb.asinh, lambda x: (1 + _square(x)).rsqrt(), lambda x: -x * (1 + _square(x)).rsqrt() / (1 + _square(x)), 2.0**-48,
    relative=True, rising=True,
)  # fmt: skip


class Affine:
    """A number that covers all points of a zonotope, x = c + r (ξ, g) + β; see the module."""

    __slots__ = ("_reach", "middle", "parts", "rest", "row", "size", "space")
    __array_ufunc__ = None
    __hash__ = None  # type: ignore[assignment]

    def __init__(
        self, space: Space, middle: float, row: np.ndarray, size: float, rest: float, reach: float | None = None
    ) -> None:
        # c; r over the deviations and the first unknowns; a quick but loose bound on |r (ξ, g)|; a bound on |β|
        self.space, self.middle, self.row, self.size, self.rest = space, middle, row, size, rest
        self._reach = None if reach is None else reach * _UP  # the result of `reach`, if already known
        self.parts: tuple[Any, Any] | None = None  # the two arguments of an undecided maximum

    def reach(self) -> float:
        """Return a bound on |r (ξ, g)|, the linear part of x."""
        if self._reach is None:
            self._reach = self.space.reach_of(self.row)
        return self._reach

    def range(self) -> tuple[float, float]:
        """Return a lower and an upper float bound on the number; `NoBound` if it is unbounded."""
        radius = self.reach() + self.rest
        if not abs(self.middle) + radius < math.inf:
            raise NoBound("no finite bound was found for an intermediate value of the law")
        if radius > 0.0:
            radius = radius * _UP + _ROUND * abs(self.middle)
        return self.middle - radius, self.middle + radius

    def largest(self) -> float:
        """Return a bound on |x| at all points of the zonotope."""
        return (abs(self.middle) + self.reach() + self.rest) * _UP

    def widened(self, left: float, *, fresh: bool = False) -> Affine:
        """Return x ± `left`: as a new unknown g_i if `fresh` and `left` > `WORTH` · `size`, otherwise as part of β."""
        if fresh and left > WORTH * self.size:
            row = np.zeros(len(self.space._totals) + self.space.unknowns + 1)
            row[: len(self.row)], row[-1] = self.row, left
            self.space.unknowns += 1
            return Affine(self.space, self.middle, row, (self.size + left) * _UP, self.rest)
        return Affine(self.space, self.middle, self.row, self.size, (self.rest + left) * _UP, self._reach)

    def __neg__(self) -> Affine:
        return Affine(self.space, -self.middle, -self.row, self.size, self.rest, self._reach)

    def __add__(self, other: Any) -> Any:
        if isinstance(other, _Places):
            return NotImplemented
        if not isinstance(other, Affine):
            return _rounded(self, self.middle + float(other), self.row, self.size, self.rest, self._reach)
        row, size = _sum(self.row, other.row), self.size + other.size
        return _rounded(self, self.middle + other.middle, row, size, self.rest + other.rest)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, _Places):
            return NotImplemented
        if not isinstance(other, Affine):
            factor = float(other)
            if factor == 0.0 and self.range():
                return 0.0
            size, rest = abs(factor) * self.size, abs(factor) * self.rest
            reach = None if self._reach is None else abs(factor) * self._reach
            return _rounded(self, factor * self.middle, factor * self.row, size, rest, reach)
        a, b = self.middle, other.middle
        row, size = _sum(a * other.row, b * self.row), abs(a) * other.size + abs(b) * self.size
        rest = abs(a) * other.rest + abs(b) * self.rest
        rest += self.rest * other.rest + self.rest * other.reach() + other.rest * self.reach()
        crossed = self.reach() * other.reach() * _UP
        if other is self:  # δx² lies in [0, crossed]
            return _rounded(self, a * b + 0.5 * crossed, row, size, rest).widened(0.5 * crossed, fresh=True)
        return _rounded(self, a * b, row, size, rest).widened(crossed, fresh=True)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Affine:
        if isinstance(other, Affine):
            return self * other._inverse()  # type: ignore[no-any-return]
        by = float(other)
        return _rounded(self, self.middle / by, self.row / by, self.size / abs(by), self.rest / abs(by))

    def __rtruediv__(self, other: Any) -> Any:
        return self._inverse() * float(other)

    def _inverse(self) -> Affine:
        low, high = self.range()
        if not (low > 0.0 or high < 0.0):
            raise NoBound("the law divides by a number that may be zero")
        return _bent(_INVERSE, self)

    def _turned(self, function: _Bend) -> Affine:
        if not self.largest() < _FARTHEST:
            raise NoBound(f"the law takes the sine or cosine of an angle that may exceed {_FARTHEST:g} rad")
        return _bent(function, self)

    sin = functools.partialmethod(_turned, _SINE)
    cos = functools.partialmethod(_turned, _COSINE)
    sinc = functools.partialmethod(_turned, _SINC)

    def floor(self) -> Any:
        """Return the largest whole number that is not above x; `_Places` if several are possible."""
        low, high = map(math.floor, self.range())
        return float(low) if low == high else _Places(self, map(float, range(low, high + 1)))

    def __bool__(self) -> bool:
        return bool(self != 0.0)

    def __lt__(self, other: Any) -> Any:
        return _compared(self, other, strictly=True)

    def __le__(self, other: Any) -> Any:
        return _compared(self, other, strictly=False)

    def __gt__(self, other: Any) -> Any:
        return _compared(other, self, strictly=True)

    def __ge__(self, other: Any) -> Any:
        return _compared(other, self, strictly=False)

    def __eq__(self, other: object) -> Any:
        low, high = (self - other).range()
        return False if low > 0.0 or high < 0.0 else _Undecided()

    def __ne__(self, other: object) -> Any:
        equal = self == other
        return equal if isinstance(equal, _Undecided) else True


def _sum(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the sum of two rows; the shorter one is padded with zeros."""
    if len(a) == len(b):
        return a + b  # type: ignore[no-any-return]
    longer, shorter = (a, b) if len(a) > len(b) else (b, a)
    total = longer.copy()
    total[: len(shorter)] += shorter
    return total


def _rounded(
    of: Affine, middle: float, row: np.ndarray, size: float, rest: float, reach: float | None = None
) -> Affine:
    """Return Affine(of.space, middle, row, size, rest, reach) with the rounding error of one operation in `rest`."""
    return Affine(of.space, middle, row, size * _UP, (rest + _ROUND * (abs(middle) + size)) * _UP + _TINY, reach)


# Choices ---------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Undecided:
    """A condition that is true at some points only: `lesser` is below `greater`; both are None for other conditions."""

    lesser: Any = None
    greater: Any = None
    __array_ufunc__ = None

    def __bool__(self) -> bool:
        raise NoBound(
            "the law compares numbers, such as a torque and its limit, and the tube does not determine which is larger"
        )

    def __and__(self, other: Any) -> Any:
        return _Undecided() if isinstance(other, _Undecided) or other else False

    def __or__(self, other: Any) -> Any:
        return _Undecided() if isinstance(other, _Undecided) or not other else True

    def __mul__(self, _: Any) -> bool:
        return bool(self)

    __rand__, __ror__, __rmul__ = __and__, __or__, __mul__

    def select(self, first: Any, second: Any) -> Any:
        """Return max(first, second) or min(first, second), as the condition selects; `NoBound` for other conditions."""
        if self.lesser is not None and first is self.greater and second is self.lesser:
            larger = self.lesser + _positive_part(self.greater - self.lesser)
            larger.parts = first, second
            return larger
        if self.lesser is not None and first is self.lesser and second is self.greater:
            level = _level(first, second)
            return self.greater - _positive_part(self.greater - self.lesser) if level is None else level
        return first if first is second else bool(self)

    def when(self, *_: Any) -> Any:
        """Raise `NoBound`: a branch needs a condition that is the same at all points."""
        return bool(self)

    only = when


def _compared(lesser: Any, greater: Any, *, strictly: bool) -> Any:
    """Return whether lesser < greater (<= unless `strictly`), or an `_Undecided` if both answers are possible."""
    low, high = (lesser - greater).range()
    if high < 0.0 or (high == 0.0 and not strictly):
        return True
    return False if low > 0.0 or (low == 0.0 and strictly) else _Undecided(lesser, greater)


def _level(a: Any, b: Any) -> Affine | None:
    """Return min(a, b) as a new unknown in [l, h] if it is an x clipped to [l, h], inside the range of x, else None."""
    larger, most = (a, b) if isinstance(a, Affine) else (b, a)
    if isinstance(most, Affine) or larger.parts is None:
        return None
    x, least = larger.parts if isinstance(larger.parts[0], Affine) else larger.parts[::-1]
    if isinstance(least, Affine):
        return None
    low, high = x.range()
    if not low < least < most < high:
        return None
    level: Affine = x.space.number(0.5 * (least + most))
    return level.widened(0.5 * (most - least) * ROUND_UP, fresh=True)


def _positive_part(x: Affine) -> Affine:
    """Return max(x, 0) as λ x + [0, c] for an x of undecided sign; λ is the slope between the end values."""
    low, high = x.range()
    slope = high / (high - low)
    most = max(-slope * low, high * (1.0 - slope)) * _UP
    line: Affine = slope * x + 0.5 * most
    return line.widened(0.5 * most, fresh=True)


class _Places:
    """A result that depends on an undecided `floor`: one value for each whole number that is possible."""

    __array_ufunc__ = None

    def __init__(self, source: Affine, values: Iterable[Any]) -> None:
        self.source, self.values = source, tuple(values)  # the argument of `floor`, and the values

    def each(self, operation: Callable[..., Any], *others: Any) -> _Places:
        """Return operation(value, *others) for each value; `NoBound` if one of `others` depends on a second `floor`."""
        if any(isinstance(one, _Places) and one.source is not self.source for one in others):
            raise NoBound("the law combines two table look-ups whose rows differ between states of the tube")
        columns = [one.values if isinstance(one, _Places) else [one] * len(self.values) for one in others]
        return _Places(self.source, map(operation, self.values, *columns))

    def __neg__(self) -> _Places:
        return self.each(operator.neg)

    def __bool__(self) -> bool:
        raise NoBound("the law rounds a number, but not to one value for all states of the tube")

    __float__ = __bool__

    def select(self, first: Any, second: Any) -> _Places:
        """Return a `_Places` with `first` where the value of this one is true, and `second` where it is false."""
        return self.each(select, first, second)

    @staticmethod
    def row(_: Any, place: _Places, *_others: Any) -> Any:
        """Raise `NoBound`: several rows of the table are possible, which only `Space.interpolated` encloses."""
        return bool(place)

    entry = row


def _in_each(operation: Callable[..., Any], *, swapped: bool = False) -> Callable[[_Places, Any], _Places]:
    return lambda one, other: one.each((lambda x, y: operation(y, x)) if swapped else operation, other)


for _name in ("add", "sub", "mul", "truediv", "and", "or"):
    setattr(_Places, f"__{_name}__", _in_each(getattr(operator, f"__{_name}__")))
    setattr(_Places, f"__r{_name}__", _in_each(getattr(operator, f"__{_name}__"), swapped=True))
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(_Places, f"__{_name}__", _in_each(getattr(operator, f"__{_name}__")))


KINDS[Affine], KINDS[_Places], KINDS[_Undecided] = Affine, _Places, _Undecided

# Functions -------------------------------------------------------------------------------------------------------


def _bent(function: _Bend, x: Affine) -> Affine:
    x.range()
    line = function.line(x.middle, (x.reach() + x.rest) * _UP)
    middle, slope = middle_of(line.value), abs(line.slope)
    rest = slope * x.rest + radius_of(line.value, middle)
    rest += function.floats * (abs(middle) + slope * (x.size + x.rest) + line.rest if function.relative else 1.0)
    return _rounded(x, middle, line.slope * x.row, slope * x.size, rest).widened(line.rest, fresh=True)


def _stick_slip(velocity: Affine, acceleration: Affine, deceleration: Affine, duration: Affine) -> tuple[Any, Any]:
    """Return the velocity v' and the angle e that `stick_slip` returns for its arguments v, α, f and h.

    The velocity is v' = v + h (α ∓ f) if the motor slips in one direction throughout, and v' = 0 if it comes to rest.
    v' and the angle e are continuous in (v, α, f), because friction does not drive two motions apart:

        0 <= ∂v'/∂v <= 1,    0 <= ∂v'/∂α <= h,        |∂v'/∂f| <= h,
        0 <= ∂e/∂v <= t,     0 <= ∂e/∂α <= t²/2,      |∂e/∂f| <= t²/2        where t <= h bounds how long it can move.

    The results are linear with the mean slopes, and the remainders the sums of half these widths times the deviations
    of v, α and f; or, if narrower, the results enclose those of any friction between -f and f.
    """
    v, a, f, h = velocity, acceleration, deceleration, duration.middle
    if duration.size or duration.rest or not f.middle >= 0.0 or not h >= 0.0:
        raise NoBound("the law predicts a motion of uncertain duration, or with dry friction that may be negative")
    floats = 2.0**-47 * (v.largest() + h * (a.largest() + f.largest()))
    for side in (1.0, -1.0):
        after = v + h * (a - side * f)
        if min(side * x for x in v.range()) >= 0.0 and min(side * x for x in after.range()) >= 0.0:
            return after.widened(floats), (0.5 * h * (v + after)).widened(h * floats)
    dv, da, df = (x.reach() + x.rest for x in (v, a, f))
    at, way = friction.stick_slip(v.middle, a.middle, f.middle, h)
    fast, pull, weak, strong = v.largest(), a.largest(), f.range()[0], f.largest()

    def line(value: float, of_v: float, of_a: float, left: float) -> Affine:
        return v.space.number(value + of_v * (v - v.middle) + of_a * (a - a.middle)).widened(left * _UP, fresh=True)

    if h * (weak - pull) >= fast + 2.0 * floats:
        t = min(fast / (weak - pull) * _UP, h)
        left = 0.5 * t * dv + 0.25 * t * t * da + 0.5 * t * t * df
        return 0.0, line(way, 0.5 * t, 0.25 * t * t, left + h * floats)
    left = 0.5 * dv + 0.5 * h * da + h * df
    if left <= h * strong:
        lost = 0.5 * h * dv + 0.25 * h * h * da + 0.5 * h * h * df
        after = line(at, 0.5, 0.5 * h, left).widened(floats)
        return after, line(way, 0.5 * h, 0.25 * h * h, lost + h * floats)
    after = (v + h * a).widened(h * strong * _UP, fresh=True).widened(floats)
    return after, (0.5 * h * (v + after)).widened((0.25 * h * h * strong + h * floats) * _UP, fresh=True)


_ENCLOSED: dict[Any, Callable[..., Any]] = {
    elementwise._gaussian.__wrapped__: functools.partial(_bent, _GAUSSIAN),  # type: ignore[attr-defined]
    network.hyperbolic_tangent.__wrapped__: functools.partial(_bent, _TANH),  # type: ignore[attr-defined]
    network.area_sine.__wrapped__: functools.partial(_bent, _ASINH),  # type: ignore[attr-defined]
    friction.stick_slip.__wrapped__: _stick_slip,  # type: ignore[attr-defined]
}
"""The functions of laws with a separate enclosure, and that enclosure."""
