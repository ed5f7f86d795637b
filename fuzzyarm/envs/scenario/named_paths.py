"""The paths that have a name: circle, lemniscate, line and square, on the paper's arm and in a plane of any other.

A square has round corners, because a reference is twice differentiable: it is the curve with x⁸ + y⁸ = a⁸.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from fuzzyarm.common import checks
from fuzzyarm.envs.scenario.paths import MINIMUM_SPACING, Circle, Lemniscate, Line, Point, Points, TipPath, any_point

__all__ = ["PAPER_PATHS", "SHAPES", "Square"]


@dataclasses.dataclass(frozen=True)
class Square:
    """p(s) = center + r (cos ψ, sin ψ), ψ = π + 2π s, r = a (cos⁸ ψ + sin⁸ ψ)^(-1/8): a square with round corners.

    It begins and ends in the middle of the side at smaller x.

    Attributes:
        center: (x, y) [m].
        half_side: a [m], > 0.

    Raises:
        ValueError: a value is not finite or out of range.
    """

    center: Point
    half_side: float

    def __post_init__(self) -> None:
        """Check the values."""
        object.__setattr__(self, "center", any_point("center", self.center, 2))
        size = checks.real("half_side", self.half_side, "m", low=MINIMUM_SPACING, high=1e6)
        object.__setattr__(self, "half_side", size)

    def points(self, s: ArrayLike) -> Points:
        """Return p [m], dp/ds and d²p/ds² [m], each (..., 2), as in `TipPath`."""
        rate = 2.0 * math.pi
        psi = math.pi + rate * np.asarray(s, dtype=float)
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
"""By name, the path of the paper's arm, and of any two-joint arm that can follow it."""

SHAPES: dict[str, Callable[[float], TipPath]] = {
    "circle": lambda size: Circle(center=(size, 0.0), radius=size, start_angle=math.pi, turns=1.0),
    "lemniscate": lambda size: Lemniscate((0.0, 0.0), size, 0.5 * math.pi),
    "line": lambda size: Line((0.0, -size), (0.0, size)),
    "square": lambda size: Square((size, 0.0), size),
}
"""By name, the path of a size [m], the half of its width, in a plane whose x points upwards, about or beside (0, 0)."""
