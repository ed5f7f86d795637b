"""Geometric paths of the tip; the time law along a path is in `reference`.

Every curve p(s), s in [0, 1], is twice differentiable. Points (x, y) lie in the plane of the two-joint arm, in the
frame of equation (26): the base at the origin, x down along gravity, y to the side. Points (x, y, z) are in a
robot's base frame; lines and splines take either, and `Placed` brings any plane curve into space.

Circle, lemniscate, line and square can be chosen by name, for the paper's arm and in a plane for any other arm. A
square has round corners, because a reference is twice differentiable: it is the curve with x⁸ + y⁸ = a⁸.

Each class raises TypeError for a value of a wrong type; and ValueError for a number out of range, too few points,
points that coincide, or axes that are not unit vectors at a right angle.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.parameters import keep_quantities, quantity

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = [
    "PAPER_PATHS", "SHAPES", "Circle", "Lemniscate", "Line", "Placed", "Spline", "Square", "TipPath", "any_point",
    "chord_spline",
]  # fmt: skip

# A point (x, y) [m], one of (x, y) or (x, y, z) [m], and p, dp/ds and d²p/ds² of a curve.
_Point = tuple[float, float]
_AnyPoint = _Point | tuple[float, float, float]
_Points = tuple[np.ndarray, np.ndarray, np.ndarray]

# Neighbouring points of a line or spline closer than this [m] give a curve without a direction.
_MINIMUM_SPACING = 1e-6

MOST_WAYPOINTS = 10_000
_FEWEST_TURNS = 1e-6  # fewest turns of a circle; with fewer it has no direction
_LARGEST = 1e6  # m, rad or turns: far above need, and squares do not overflow


@runtime_checkable
class TipPath(Protocol):
    """Protocol of a path: any class with this method can be used.

    A curve whose second derivative has corners may list them in an attribute `corners`, ascending values of s; code
    that differentiates further (`elastic_reference`) is then exact at the corners, too.
    """

    def points(self, s: ArrayLike) -> _Points:
        """Return p [m], dp/ds [m] and d²p/ds² [m], each of shape (..., 2) or (..., 3), for s (...,) in [0, 1]."""
        ...


def _number(unit: str, default: Any = dataclasses.MISSING, **bounds: Any) -> Any:
    """Return a field of a curve, see `quantity`; its values are at most `_LARGEST` in magnitude."""
    return quantity(unit, default, **{"low": -_LARGEST, "high": _LARGEST, **bounds})


@dataclasses.dataclass(frozen=True)
class Circle:
    """p(s) = center + R (cos ψ, sin ψ), ψ(s) = ψ_0 + 2π n s; the defaults are the paper's curve.

    Center and radius are printed in section 6.1.3, start angle and direction are not: ψ_0 = π/2 with ψ decreasing
    (and the elbow q2 > 0) is the choice that gives the peak torques 228 and 47 N m which the paper reports.

    Attributes:
        center: (x, y) [m].
        radius: R [m], > 0.
        start_angle: ψ_0 [rad].
        turns: n, signed number of full turns, not zero; negative turns from +y towards +x. A fraction gives an arc.

    Examples:
        >>> position, first, second = Circle().points([0.0, 0.5])
        >>> position.round(6).tolist()
        [[0.35, 0.85], [0.35, 0.45]]
    """

    center: _Point = _number("m", (0.35, 0.65), count=2)
    radius: float = _number("m", 0.2, low=_MINIMUM_SPACING)
    start_angle: float = _number("rad", math.pi / 2)
    turns: float = _number("turns", -1.0)

    def __post_init__(self) -> None:
        keep_quantities(self)
        if abs(self.turns) < _FEWEST_TURNS:
            raise ValueError(f"turns = {self.turns} is out of range; allowed: ±[{_FEWEST_TURNS:g}, {_LARGEST:g}]")

    @property
    def circle(self) -> tuple[np.ndarray, float]:
        """Center (2,) [m] and radius [m]."""
        return np.array(self.center), self.radius

    def points(self, s: ArrayLike) -> _Points:
        """Return p, dp/ds, d²p/ds² as in `TipPath`."""
        rate = 2.0 * math.pi * self.turns
        psi = self.start_angle + rate * _numbers(s)
        outward = self.radius * np.stack([np.cos(psi), np.sin(psi)], axis=-1)
        along = self.radius * np.stack([-np.sin(psi), np.cos(psi)], axis=-1)
        return np.array(self.center) + outward, rate * along, -(rate**2) * outward


@dataclasses.dataclass(frozen=True)
class Line:
    """p(s) = start + s (end - start).

    Attributes:
        start: (x, y) or (x, y, z) [m] at s = 0.
        end: (x, y) or (x, y, z) [m] at s = 1, at least `_MINIMUM_SPACING` from start.
    """

    start: _AnyPoint
    end: _AnyPoint

    def __post_init__(self) -> None:
        checks.keep(self, "start", any_point("start", self.start))
        checks.keep(self, "end", any_point("end", self.end, len(self.start)))
        _require_apart("start", self.start, "end", self.end)

    def points(self, s: ArrayLike) -> _Points:
        """Return p, dp/ds, d²p/ds² as in `TipPath`."""
        s = _numbers(s)[..., np.newaxis]
        start, direction = np.array(self.start), np.array(self.end) - np.array(self.start)
        return start + s * direction, np.ones_like(s) * direction, np.zeros_like(s) * direction


@dataclasses.dataclass(frozen=True)
class Lemniscate:
    """Gerono's eight, p(s) = center + R(α) a (sin θ, sin θ cos θ), θ = 2π s: x⁴ = a² (x² - y²) along its axes.

    It starts and ends at the crossing and is 2a long and a high.

    Attributes:
        center: the crossing (x, y) [m].
        half_width: a [m], > 0.
        angle: α [rad], turns the long axis from x towards y.
    """

    center: _Point = _number("m", count=2)
    half_width: float = _number("m", low=_MINIMUM_SPACING)
    angle: float = _number("rad", 0.0)

    def __post_init__(self) -> None:
        keep_quantities(self)

    def points(self, s: ArrayLike) -> _Points:
        """Return p, dp/ds, d²p/ds² as in `TipPath`."""
        rate = 2.0 * math.pi
        theta = rate * _numbers(s)
        # sin θ cos θ = sin(2θ) / 2
        shape = np.stack([np.sin(theta), 0.5 * np.sin(2.0 * theta)], axis=-1)
        d_shape = np.stack([np.cos(theta), np.cos(2.0 * theta)], axis=-1)
        dd_shape = np.stack([-np.sin(theta), -2.0 * np.sin(2.0 * theta)], axis=-1)
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        axes = self.half_width * np.array([[cos, sin], [-sin, cos]])  # rows: long axis, short axis
        return np.array(self.center) + shape @ axes, rate * d_shape @ axes, rate**2 * dd_shape @ axes


@dataclasses.dataclass(frozen=True)
class Spline:
    """The twice continuously differentiable cubic spline through given points.

    From each point to the next, s grows in proportion to their distance. Open ends are "not-a-knot": two points give
    a line, three a parabola. A closed spline returns to the first point with the same first and second derivative.

    Attributes:
        waypoints: two or more points (x, y) or (x, y, z) [m] (any sequence or array), neighbours at least
            `_MINIMUM_SPACING` apart. A closed spline returns by itself: do not repeat the first point.
        closed: whether the curve returns to its start.
    """

    waypoints: tuple[_AnyPoint, ...]
    closed: bool = False

    def __post_init__(self) -> None:
        try:
            given = list(itertools.islice(self.waypoints, MOST_WAYPOINTS + 1))
        except TypeError:
            raise ValueError(
                f"waypoints = {checks.shown(self.waypoints)} must be a sequence of points (x, y) or (x, y, z) [m]"
            ) from None
        size = len(any_point("waypoints[0]", given[0])) if given else None
        points = tuple(any_point(f"waypoints[{k}]", point, size) for k, point in enumerate(given))
        if not 2 <= len(points) <= MOST_WAYPOINTS:
            found = "fewer than 2 points" if len(points) < 2 else f"more than {MOST_WAYPOINTS} points"
            raise ValueError(f"waypoints has {found}; allowed: 2 to {MOST_WAYPOINTS} distinct points")
        checks.keep(self, "waypoints", points)
        checks.truth("closed", self.closed)
        last = len(points) if self.closed else len(points) - 1
        for k in range(last):
            after = (k + 1) % len(points)
            _require_apart(f"waypoints[{k}]", points[k], f"waypoints[{after}]", points[after])

    @functools.cached_property
    def _interpolant(self) -> CubicSpline:
        points = np.array(self.waypoints + self.waypoints[:1] if self.closed else self.waypoints)
        return chord_spline(points, closed=self.closed)

    @property
    def corners(self) -> np.ndarray:
        """Return s at the inner waypoints, where the third derivative jumps."""
        return np.asarray(self._interpolant.x[1:-1])

    @property
    def polynomials(self) -> tuple[np.ndarray, np.ndarray]:
        """Knots (k + 1,) of s, and coefficients (4, k, 2 or 3) [m] of p in powers of s - knot, the cubic ones first."""
        return self._interpolant.x, self._interpolant.c

    def points(self, s: ArrayLike) -> _Points:
        """Return p, dp/ds, d²p/ds² as in `TipPath`."""
        s, spline = np.asarray(s, dtype=float), self._interpolant
        return spline(s), spline(s, 1), spline(s, 2)


def chord_spline(points: np.ndarray, *, closed: bool = False) -> CubicSpline:
    """Return the cubic spline in s from 0 to 1 through points (k, d); if closed, the last must equal the first."""
    from scipy.interpolate import CubicSpline  # SciPy is only needed here

    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    knots = np.append(0.0, np.cumsum(chords))
    return CubicSpline(knots / knots[-1], points, bc_type="periodic" if closed else "not-a-knot")


def _numbers(s: ArrayLike) -> np.ndarray:
    """Return s as floats, or unchanged if it contains other numbers, such as balls (intervals)."""
    return s if isinstance(s, np.ndarray) and s.dtype == object else np.asarray(s, dtype=float)


def any_point(name: str, value: Any, size: int | None = None) -> Any:
    """Return a point with two or three finite coordinates [m], or with `size` coordinates if that is given."""
    count = size or (3 if checks.is_sequence(value, 3) else 2)
    return checks.reals(name, value, count, "m", low=-_LARGEST, high=_LARGEST)


def _require_apart(first_name: str, first: _AnyPoint, second_name: str, second: _AnyPoint) -> None:
    spacing = math.dist(first, second)
    if spacing < _MINIMUM_SPACING:
        raise ValueError(
            f"{first_name} = {first} and {second_name} = {second} are {spacing:g} m apart; "
            f"allowed: [{_MINIMUM_SPACING:g}, inf) m"
        )


@dataclasses.dataclass(frozen=True)
class Square:
    """p(s) = center + r (cos ψ, sin ψ), ψ = π + 2π s, r = a (cos⁸ ψ + sin⁸ ψ)^(-1/8): a square with round corners.

    It begins and ends at the middle of the side with the smaller x.

    Attributes:
        center: (x, y) [m].
        half_side: a [m], > 0.
    """

    center: _Point = _number("m", count=2)
    half_side: float = _number("m", low=_MINIMUM_SPACING)

    def __post_init__(self) -> None:
        keep_quantities(self)

    def points(self, s: ArrayLike) -> _Points:
        """Return p [m], dp/ds and d²p/ds² [m], each (..., 2), as in `TipPath`."""
        rate = 2.0 * math.pi
        psi = math.pi + rate * _numbers(s)
        c, z = np.cos(psi), np.sin(psi)
        f, df = c**8 + z**8, 8.0 * (z**7 * c - c**7 * z)
        ddf = 56.0 * c**2 * z**2 * (c**4 + z**4) - 8.0 * f
        r = self.half_side * f ** (-1 / 8)
        dr = -r * df / (8.0 * f)
        ddr = r * (9.0 / 64.0 * (df / f) ** 2 - ddf / (8.0 * f))
        outward, along = np.stack([c, z], axis=-1), np.stack([-z, c], axis=-1)
        r, dr, ddr = (part[..., np.newaxis] for part in (r, dr, ddr))
        first, second = dr * outward + r * along, (ddr - r) * outward + 2.0 * dr * along
        return np.array(self.center) + r * outward, rate * first, rate**2 * second


PAPER_PATHS: dict[str, TipPath] = {
    "circle": Circle(),
    "lemniscate": Lemniscate((0.4, 0.5), 0.2),
    "line": Line((0.35, 0.45), (0.35, 0.85)),
    "square": Square((0.35, 0.65), 0.15),
}
"""Paths by name, for the paper's arm and for any two-joint arm that can follow them."""

SHAPES: dict[str, Callable[[float], TipPath]] = {
    "circle": lambda size: Circle(center=(size, 0.0), radius=size, start_angle=math.pi, turns=1.0),
    "lemniscate": lambda size: Lemniscate((0.0, 0.0), size, 0.5 * math.pi),
    "line": lambda size: Line((0.0, -size), (0.0, size)),
    "square": lambda size: Square((size, 0.0), size),
}
"""Paths by name, as functions of half the width [m], in a plane with x upwards, centered or beginning at (0, 0)."""

_SQUARE = 1e-6  # largest deviation of the axes from unit length and a right angle; it is then removed


@dataclasses.dataclass(frozen=True)
class Placed:
    """p(s) = origin + x(s) e_1 + y(s) e_2 for a plane curve (x, y) and two axes at right angles.

    Attributes:
        path: the plane curve: `Circle`, `Lemniscate`, or any other `TipPath` with points (..., 2).
        origin: position (x, y, z) [m] of the plane's (0, 0); (x, y) for a curve in the plane of the two-joint arm.
        first: e_1, direction of the plane's x, a unit vector.
        second: e_2, direction of the plane's y, a unit vector; the plane faces e_1 × e_2.

    Examples:
        >>> facing_x = Placed(Circle(center=(0.0, 0.0), radius=0.1), (0.5, 0.0, 0.4), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        >>> facing_x.points(0.0)[0].round(6).tolist()
        [0.5, 0.0, 0.5]
    """

    path: TipPath
    origin: _AnyPoint
    first: _AnyPoint
    second: _AnyPoint

    def __post_init__(self) -> None:
        if not isinstance(self.path, TipPath):
            raise TypeError(f"path = {checks.shown(self.path)} needs a method points(s) that returns points (..., 2)")
        size = 2 if checks.is_sequence(self.origin, 2) else 3
        checks.keep(self, "origin", any_point("origin", self.origin, size))
        axes = np.array([any_point(name, getattr(self, name), size) for name in ("first", "second")])
        if not np.abs(axes @ axes.T - np.eye(2)).max() <= _SQUARE:
            raise ValueError(
                f"first = {self.first} and second = {self.second} must be unit vectors at right angles; their lengths "
                f"are {np.linalg.norm(axes[0]):.6g} and {np.linalg.norm(axes[1]):.6g}, and their dot product is "
                f"{axes[0] @ axes[1]:.3g}"
            )

    @property
    def axes(self) -> np.ndarray:
        """The plane's axes e_1 and e_2 as orthonormal rows, (2, 3), or (2, 2) for the two-joint arm."""
        first, second = np.array(self.first), np.array(self.second)
        first = first / np.linalg.norm(first)
        second = second - (second @ first) * first
        return np.stack([first, second / np.linalg.norm(second)])

    @property
    def corners(self) -> np.ndarray:
        """Return the values (k,) of s, listed by the plane curve, at which its second derivative has a kink."""
        return np.asarray(getattr(self.path, "corners", ()), dtype=float)

    @property
    def circle(self) -> tuple[np.ndarray, float] | None:
        """Center (3,) or (2,) [m] and radius [m] if the plane curve is a `Circle`, else None."""
        if not isinstance(self.path, Circle):
            return None
        return np.array(self.origin) + np.array(self.path.center) @ self.axes, self.path.radius

    def points(self, s: ArrayLike) -> _Points:
        """Return p, dp/ds, d²p/ds² as in `TipPath`."""
        p, dp, ddp = self.path.points(s)
        axes = self.axes
        return np.array(self.origin) + p @ axes, dp @ axes, ddp @ axes

    def normals(self, s: ArrayLike) -> np.ndarray:
        """Return the left unit normals (..., 3) or (..., 2) of the curve in its plane, for s of shape (...,)."""
        _, derivative, _ = self.path.points(s)
        left = np.stack([-derivative[..., 1], derivative[..., 0]], axis=-1)
        return np.asarray(left / np.linalg.norm(left, axis=-1, keepdims=True) @ self.axes)
