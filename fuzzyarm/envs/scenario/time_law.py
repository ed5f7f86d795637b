"""The time law of every reference, from rest to rest: how far along its curve the arm is at a time.

s(t) = 10 x³ - 15 x⁴ + 6 x⁵,  x = t/T;      p(t) = p(s(t)),   ṗ = p' ṡ,   p̈ = p'' ṡ² + p' s̈
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["LONGEST", "SHORTEST", "Curve", "along", "corner_times", "quintic_time_law", "time_at"]

SHORTEST, LONGEST = 1e-6, 1e6  # s, allowed durations


class Curve(Protocol):
    """Anything with p, dp/ds and d²p/ds² for s in [0, 1]: a path of the tip, or a spline of the joints."""

    def points(self, s: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return p, dp/ds and d²p/ds², each of shape (..., d), for s of shape (...,)."""
        ...


def quintic_time_law(t: ArrayLike, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return s = 10 x³ - 15 x⁴ + 6 x⁵, ṡ [1/s] and s̈ [1/s²], x = t/duration clamped to [0, 1]; shapes as t [s].

    ṡ and s̈ vanish at both ends and beyond; the largest ṡ is 1.875 / duration, half-way.
    """
    x = np.clip(np.asarray(t, dtype=float) / duration, 0.0, 1.0)
    s = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    ds = 30.0 * (x * (1.0 - x)) ** 2 / duration
    dds = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration**2
    return s, ds, dds


def along(curve: Curve, t: ArrayLike, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return p, ṗ = p' ṡ and p̈ = p'' ṡ² + p' s̈, shapes (..., d), at times t [s] of shape (...,)."""
    s, ds, dds = quintic_time_law(t, duration)
    p, dp, ddp = curve.points(s)
    ds, dds = ds[..., np.newaxis], dds[..., np.newaxis]
    return p, dp * ds, ddp * ds**2 + dp * dds


def corner_times(corners: ArrayLike, duration: float) -> np.ndarray:
    """Return the times (k,) [s] at which p̈ has a corner, ascending: the ends, and the curve's own, s (...,)."""
    return np.unique([0.0, *time_at(corners, duration), duration])


def time_at(s: ArrayLike, duration: float) -> np.ndarray:
    """Return the times [s], shape (...,), at which s(t) has values of shape (...,) in [0, 1]."""
    from scipy.special import betaincinv

    # s(x) is the regularised incomplete beta function I_x(3, 3).
    return np.asarray(duration * betaincinv(3.0, 3.0, np.asarray(s, dtype=float)))
