"""A matrix of trigonometric polynomials on a box of angles lies in the convex hull of its control matrices.

Let f be a combination of 1, cos q, sin q, cos 2q and sin 2q, and q = m + t with |t| <= h < π/2. With

    a = sin((h - t)/2) / sin h,    b = sin((h + t)/2) / sin h,    a² + 2 cos h ab + b² = 1,
    cos t = cos h (a² + b²) + 2ab,    sin t = sin h (b² - a²),

f is a form of degree four in (a, b), and 1 = (a² + 2 cos h ab + b²)² = Σ κ_i a^(4-i) b^i with κ = (1, 4 cos h,
2 + 4 cos² h, 4 cos h, 1). As a and b are not negative, f(q) = Σ_i f_i (κ_i a^(4-i) b^i) is a mean of the control values
f_i. Taken for each angle in turn this holds for a matrix of d angles and its 5^d control matrices: if all of them are
positive definite, so is the matrix everywhere in the box. The excess of the hull falls with h².

Here this is done in floating point for many boxes at once, with a bound of all rounding errors;
`proven_in_balls` does the same in balls.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.proof.kinetic_energy import BASIS

__all__ = ["WIDEST", "TrigMatrix", "control_weights", "packed", "unpacked"]

WIDEST = 0.8
"""Largest h [rad]: half the width of a box."""


@dataclasses.dataclass(frozen=True)
class TrigMatrix:
    """A symmetric matrix of trigonometric polynomials.

    Attributes:
        exact: coefficients as exact rationals, (5, ..., 5, s, s), an axis for each angle, see `kinetic_energy.BASIS`.
    """

    exact: np.ndarray

    @property
    def angles(self) -> int:
        """Number d of the angles."""
        return self.exact.ndim - 2

    @property
    def size(self) -> int:
        """Number s of rows."""
        return int(self.exact.shape[-1])

    @functools.cached_property
    def coefficients(self) -> np.ndarray:
        """The nearest floats, packed as (5, ..., 5, s(s + 1)/2)."""
        return packed(self.exact).astype(np.float64)

    @functools.cached_property
    def magnitude(self) -> np.ndarray:
        """Σ |coefficient| of each packed entry: no value, control value or sum on the way exceeds a few of it."""
        return np.asarray(np.abs(self.coefficients).sum(axis=tuple(range(self.angles))))

    def at(self, q: np.ndarray) -> np.ndarray:
        """Return the matrices (..., s, s) at angles (..., d) [rad], in floating point."""
        lanes = q.shape[:-1]
        values = self.coefficients.reshape(1, -1)
        for k in range(self.angles):
            c, s = np.cos(q[..., k]).ravel(), np.sin(q[..., k]).ravel()
            functions = np.stack([np.ones_like(c), c, s, c * c - s * s, 2.0 * c * s], axis=-1)
            rows = values.reshape(len(values), BASIS, -1)
            # The first angle is the same matrix for all: it is not copied for each of them.
            values = functions @ rows[0] if k == 0 else (functions[:, np.newaxis] @ rows)[:, 0]
        triangle = (self.coefficients.shape[-1],)
        if self.angles == 0:
            return unpacked(np.broadcast_to(self.coefficients, lanes + triangle), self.size)
        return unpacked(values.reshape(lanes + triangle), self.size)

    def derivative(self, angle: int) -> TrigMatrix:
        """Return the derivative by one angle."""
        source = np.moveaxis(self.exact, angle, 0)
        # cos q, sin q, cos 2q, sin 2q become -sin q, cos q, -2 sin 2q, 2 cos 2q.
        result = np.stack([0 * source[0], source[2], -source[1], 2 * source[4], -2 * source[3]])
        return TrigMatrix(np.moveaxis(result, 0, angle))

    def needed(self) -> list[int]:
        """Return the angles that the matrix depends on."""
        return [k for k in range(self.angles) if any(entry != 0 for entry in np.moveaxis(self.exact, k, 0)[1:].ravel())]

    def of_needed(self) -> TrigMatrix:
        """Return the matrix as one of the `needed` angles only."""
        needed = self.needed()
        return TrigMatrix(self.exact[tuple(slice(None) if k in needed else 0 for k in range(self.angles))])


def packed(matrices: np.ndarray) -> np.ndarray:
    """Return the numbers of the lower triangles (..., s(s + 1)/2) of symmetric matrices (..., s, s), row by row."""
    row, column = np.tril_indices(matrices.shape[-1])
    return matrices[..., row, column]


def unpacked(triangles: np.ndarray, size: int) -> np.ndarray:
    """Return the symmetric matrices (..., s, s) whose lower triangles hold the given numbers, see `packed`."""
    result = np.empty((*triangles.shape[:-1], size, size), dtype=triangles.dtype)
    row, column = np.tril_indices(size)
    result[..., row, column] = result[..., column, row] = triangles
    return result


def control_weights(cos_m: Any, sin_m: Any, cos_h: Any, sin_h: Any) -> list[list[Any]]:
    """Return the matrix (5, 5) from the coefficients of one angle to its control values, as nested lists.

    Generic in its numbers: arrays of many boxes, or balls.

    Args:
        cos_m: of the middle of the interval.
        sin_m: likewise.
        cos_h: of half its width, above 0.
        sin_h: likewise.
    """
    c, s = cos_h, sin_h
    # Control values of cos t, sin t, cos 2t, sin 2t: their coefficients of a⁴, a³b, a²b², ab³, b⁴ over κ.
    edge, middle, one = (c + 1 / c) / 2, 3 / (1 + 2 * c * c), c * 0 + 1
    cos_t, sin_t = [c, edge, c * middle, edge, c], [-s, -s / 2, 0 * s, s / 2, s]
    outer = 2 * c * c - 1
    cos_2t, sin_2t = [outer, one, middle, one, outer], [-2 * s * c, -s / c, 0 * s, s / c, 2 * s * c]
    cos_2m, sin_2m = cos_m * cos_m - sin_m * sin_m, 2 * sin_m * cos_m
    return [
        [
            one,
            cos_m * cos_t[i] - sin_m * sin_t[i],
            sin_m * cos_t[i] + cos_m * sin_t[i],
            cos_2m * cos_2t[i] - sin_2m * sin_2t[i],
            sin_2m * cos_2t[i] + cos_2m * sin_2t[i],
        ]
        for i in range(BASIS)
    ]
