"""A curve of a plane, placed in space."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzyarm.common import checks
from fuzzyarm.envs.scenario.paths import AnyPoint, Circle, Points, TipPath, any_point

__all__ = ["Placed"]

SQUARE = 1e-6  # by which the axes may miss unit length and a right angle; they are then made exact


@dataclasses.dataclass(frozen=True)
class Placed:
    """p(s) = origin + x(s) e_1 + y(s) e_2 for a plane curve (x, y) and two axes at right angles.

    Attributes:
        path: the plane curve: `Circle`, `Lemniscate`, or any other `TipPath` with points (..., 2).
        origin: where (0, 0) of the plane lies, (x, y, z) [m]; (x, y) for a curve in the plane of the two-joint arm.
        first: e_1, direction of the plane's x, a unit vector.
        second: e_2, direction of the plane's y, likewise; the plane faces e_1 × e_2.

    Raises:
        TypeError: `path` has no method ``points``.
        ValueError: a value is not finite, or the axes are no unit vectors at right angles.

    Examples:
        >>> from fuzzyarm.envs.scenario.paths import Circle
        >>> facing_x = Placed(Circle(center=(0.0, 0.0), radius=0.1), (0.5, 0.0, 0.4), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        >>> from fuzzyarm.envs.scenario.paths import Circle
        >>> facing_x.points(0.0)[0].round(6).tolist()
        [0.5, 0.0, 0.5]
    """

    path: TipPath
    origin: AnyPoint
    first: AnyPoint
    second: AnyPoint

    def __post_init__(self) -> None:
        """Check the values."""
        if not isinstance(self.path, TipPath):
            raise TypeError(f"path = {checks.shown(self.path)} must have a method points(s) with points (..., 2)")
        size = 2 if checks.is_sequence(self.origin, 2) else 3
        _keep(self, "origin", any_point("origin", self.origin, size))
        axes = np.array([any_point(name, getattr(self, name), size) for name in ("first", "second")])
        if not np.abs(axes @ axes.T - np.eye(2)).max() <= SQUARE:
            raise ValueError(
                f"first = {self.first} and second = {self.second} must be unit vectors at right angles; their lengths "
                f"are {np.linalg.norm(axes[0]):.6g} and {np.linalg.norm(axes[1]):.6g}, their product "
                f"{axes[0] @ axes[1]:.3g}"
            )

    @property
    def axes(self) -> np.ndarray:
        """Rows e_1 and e_2, (2, 3) or (2, 2), of unit length and at a right angle to the last digit."""
        first, second = np.array(self.first), np.array(self.second)
        first = first / np.linalg.norm(first)
        second = second - (second @ first) * first
        return np.stack([first, second / np.linalg.norm(second)])

    @property
    def corners(self) -> np.ndarray:
        """Return s where the second derivative of the plane curve has corners."""
        return np.asarray(getattr(self.path, "corners", ()), dtype=float)

    @property
    def circle(self) -> tuple[np.ndarray, float] | None:
        """Center (3,) or (2,) [m] and radius [m] where the plane curve is a `Circle`."""
        if not isinstance(self.path, Circle):
            return None
        return np.array(self.origin) + np.array(self.path.center) @ self.axes, self.path.radius

    def points(self, s: ArrayLike) -> Points:
        """Return p, dp/ds, d²p/ds² as in `TipPath`."""
        p, dp, ddp = self.path.points(s)
        axes = self.axes
        return np.array(self.origin) + p @ axes, dp @ axes, ddp @ axes

    def normals(self, s: ArrayLike) -> np.ndarray:
        """Return the left unit normals (..., 3) or (..., 2) of the curve in its plane, for s of shape (...,)."""
        _, derivative, _ = self.path.points(s)
        left = np.stack([-derivative[..., 1], derivative[..., 0]], axis=-1)
        return np.asarray(left / np.linalg.norm(left, axis=-1, keepdims=True) @ self.axes)


def _keep(path: object, name: str, value: Any) -> None:
    object.__setattr__(path, name, value)
