"""Proof that a matrix of trigonometric polynomials is positive definite at every point of a box of angles.

*Hull.* On a box of angles the matrix lies in the convex hull of its control matrices. Let f be a combination of 1, cos
q, sin q, cos 2q and sin 2q, and q = m + t with |t| <= h < π/2. With

    a = sin((h - t)/2) / sin h,    b = sin((h + t)/2) / sin h,    a² + 2 cos h ab + b² = 1,
    cos t = cos h (a² + b²) + 2ab,    sin t = sin h (b² - a²),

f is a form of degree four in (a, b), and 1 = (a² + 2 cos h ab + b²)² = Σ κ_i a^(4-i) b^i with κ = (1, 4 cos h,
2 + 4 cos² h, 4 cos h, 1). As a and b are not negative, f(q) = Σ_i f_i (κ_i a^(4-i) b^i) is a mean of the control values
f_i. Applied to each angle in turn, this gives 5^d control matrices for a matrix of d angles: if all of these are
positive definite, so is the matrix everywhere in the box.

*Cover.* The box is cut into smaller boxes until all control matrices of each box are positive definite. In floating
point, every rounding error is bounded:

- the control matrices are sums of products of coefficients and weights, whose error is below a multiple of the sum of
  the coefficients' magnitudes for each entry;
- Cholesky's factorisation of A - δI in floating point ends with real roots only if A - δI + ΔA is positive semidefinite
  for some |ΔA| <= γ/(1 - γ) tr A, γ = (s + 1) u/(1 - (s + 1) u) (Rump, 2006), so a δ above this bound proves A > 0.

The only assumption is that sines and cosines of the mathematical library are accurate to `_LIBRARY` units in the last
place. `proven_in_balls` proves the same boxes again without this assumption, in balls with outward rounding
(FLINT's `arb`), by Gershgorin's theorem on T A Tᵀ, as in `definiteness`.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Any

import numpy as np
from flint import arb, arb_mat

from fuzzyarm.proof.definiteness import is_dominant

__all__ = ["BASIS", "TrigMatrix", "cover", "proven_in_balls"]

BASIS = 5  # functions of one angle: 1, cos q, sin q, cos 2q, sin 2q
_WIDEST = 0.8  # largest h [rad]: half the width of a box


@dataclasses.dataclass(frozen=True)
class TrigMatrix:
    """A symmetric matrix of trigonometric polynomials."""

    exact: np.ndarray  # coefficients as exact rationals, (5, ..., 5, s, s), an axis for each angle, see `BASIS`

    @property
    def angles(self) -> int:
        """The number d of angles."""
        return self.exact.ndim - 2

    @property
    def size(self) -> int:
        """The number s of rows of the matrix."""
        return int(self.exact.shape[-1])

    @functools.cached_property
    def coefficients(self) -> np.ndarray:
        """The coefficients `exact` as floats, their lower triangles packed: (5, ..., 5, s(s + 1)/2)."""
        return _packed(self.exact).astype(np.float64)

    def at(self, q: np.ndarray) -> np.ndarray:
        """Return the matrices (..., s, s) at angles (..., d) [rad], in floating point."""
        values = self.coefficients.reshape(1, -1)
        for k in range(self.angles):
            c, s = np.cos(q[..., k]).ravel(), np.sin(q[..., k]).ravel()
            functions = np.stack([np.ones_like(c), c, s, c * c - s * s, 2.0 * c * s], axis=-1)
            rows = values.reshape(len(values), BASIS, -1)
            # The coefficients are the same for all points before the first angle, so they are not copied.
            values = functions @ rows[0] if k == 0 else (functions[:, np.newaxis] @ rows)[:, 0]
        shape = (*q.shape[:-1], self.coefficients.shape[-1])
        return _unpacked(values.reshape(shape) if self.angles else np.broadcast_to(values[0], shape), self.size)

    def derivative(self, angle: int) -> TrigMatrix:
        """Return the derivative of the matrix with respect to the angle with this index."""
        source = np.moveaxis(self.exact, angle, 0)
        # cos q, sin q, cos 2q, sin 2q become -sin q, cos q, -2 sin 2q, 2 cos 2q.
        result = np.stack([0 * source[0], source[2], -source[1], 2 * source[4], -2 * source[3]])
        return TrigMatrix(np.moveaxis(result, 0, angle))

    def needed(self) -> tuple[TrigMatrix, list[int]]:
        """Return the matrix as a function of only the angles on which it depends, and the indices of these angles."""
        needed = [k for k in range(self.angles) if np.moveaxis(self.exact, k, 0)[1:].any()]
        return TrigMatrix(self.exact[tuple(slice(None) if k in needed else 0 for k in range(self.angles))]), needed


def _packed(matrices: np.ndarray) -> np.ndarray:
    """Return the lower triangles (..., s(s + 1)/2) of symmetric matrices (..., s, s), row by row."""
    row, column = np.tril_indices(matrices.shape[-1])
    return matrices[..., row, column]


def _unpacked(triangles: np.ndarray, size: int) -> np.ndarray:
    """Return symmetric matrices (..., s, s), s = `size`, from lower triangles (..., s(s + 1)/2) as from `_packed`."""
    result = np.empty((*triangles.shape[:-1], size, size), dtype=triangles.dtype)
    row, column = np.tril_indices(size)
    result[..., row, column] = result[..., column, row] = triangles
    return result


def _control_weights(cos_m: Any, sin_m: Any, cos_h: Any, sin_h: Any) -> list[list[Any]]:
    """Return the matrix (5, 5), as nested lists, from coefficients of 1, cos q, ..., sin 2q to the control values f_i.

    The arguments are cosines and sines of the interval's middle m and half width h > 0 [rad], as arrays or balls.
    """
    c, s = cos_h, sin_h
    # Control values of cos t, sin t, cos 2t, sin 2t: their coefficients of a⁴, a³b, a²b², ab³, b⁴, divided by κ.
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


_MOST_BOXES = 400_000  # boxes after which a proof is given up
_CHUNK = 256  # boxes at a time
_UNIT = 2.0**-53
_LIBRARY = 4
_WIDENING = 2.0**-44  # rad, more than the rounding errors of an interval's middle and half width up to 100 rad


def _first_boxes(ranges: np.ndarray) -> np.ndarray:
    """Return boxes (B, d, 2) that together fill the box `ranges` (d, 2), each at most 2 `_WIDEST` wide."""
    spans = []
    for low, high in ranges[::-1]:
        ends = np.linspace(low, high, max(1, int(np.ceil((high - low) / (1.9 * _WIDEST)))) + 1)
        ends[0], ends[-1] = low, high  # the exact ends, despite the rounding of linspace
        spans.append([*itertools.pairwise(ends)])
    boxes = [*itertools.product(*spans)]
    return np.array(boxes).reshape(len(boxes), len(ranges), 2)[:, ::-1]


def cover(matrix: TrigMatrix, ranges: np.ndarray, most: int = _MOST_BOXES) -> tuple[np.ndarray, np.ndarray | None]:
    """Prove a matrix positive definite for all angles in `ranges` (d, 2), within ±100 rad, with at most `most` boxes.

    Return the proven boxes (B, d, 2), (lowest, highest) angles [rad]; and angles (d,) where the proof fails, or None.
    """
    center = ranges.mean(axis=1)
    diagonal = np.diagonal(matrix.at(center))
    if not (np.isfinite(diagonal).all() and (diagonal > 0.0).all()):
        return np.empty((0, len(ranges), 2)), center
    task = _Task(matrix, 2.0 ** -np.round(0.5 * np.log2(diagonal)))  # powers of two, for a diagonal near one
    waiting, done, tried = [_first_boxes(ranges)], [], 0
    while waiting:
        boxes = waiting.pop()
        if len(boxes) > _CHUNK:
            waiting.append(boxes[_CHUNK:])
            boxes = boxes[:_CHUNK]
        tried += len(boxes)
        good = _definite(task.controls(boxes), matrix.size, task.shift)
        done.append(boxes[good])
        bad = boxes[~good]
        if len(bad) == 0:
            continue
        points = bad.mean(axis=2)
        fails = ~_definite(_packed(matrix.at(points))[:, np.newaxis] * task.scale, matrix.size, task.shift)
        if fails.any() or tried > most:
            return np.concatenate(done), points[fails][0] if fails.any() else points[0]
        waiting.append(_halved(bad, task.weight))
    return np.concatenate(done), None


class _Task:
    """A scaled matrix to be proven positive definite; `coefficients` (5, ..., 5, s(s + 1)/2) are lower triangles.

    `shift`, subtracted from the diagonal, exceeds rounding errors; `weight` (d,) bounds second derivatives by angle.
    """

    def __init__(self, matrix: TrigMatrix, scale: np.ndarray) -> None:
        self.scale, d = _packed(scale[:, np.newaxis] * scale), matrix.angles
        self.coefficients = matrix.coefficients * self.scale
        # No value, control value or intermediate sum exceeds a few times Σ |coefficient|.
        magnitude = np.abs(matrix.coefficients).sum(axis=tuple(range(d))) * self.scale
        self.weight = np.empty(d)
        for k in range(d):
            along = np.abs(np.moveaxis(self.coefficients, k, 0)).reshape(BASIS, -1).sum(axis=1)
            self.weight[k] = along[1] + along[2] + 4.0 * (along[3] + along[4])
        # Weights are below 8 in a row and wrong by less than 64 _LIBRARY units each; sums of five add as much again.
        error = _unpacked(100.0 * _LIBRARY * max(d, 1) * 8.0**d * _UNIT * magnitude, matrix.size)
        trace = 4.0 * magnitude.sum()
        self.shift = float(1.01 * error.sum(axis=1).max() + 4.0 * (matrix.size + 2) * _UNIT * trace)

    def controls(self, boxes: np.ndarray) -> np.ndarray:
        """Return the packed control matrices (B, 5^d, s(s + 1)/2) of boxes (B, d, 2) [rad]."""
        count, d = boxes.shape[:2]
        middle, half = boxes.mean(axis=2), 0.5 * (boxes[..., 1] - boxes[..., 0]) + _WIDENING
        weights = np.array(_control_weights(np.cos(middle), np.sin(middle), np.cos(half), np.sin(half)))
        values = np.broadcast_to(self.coefficients, (count, *self.coefficients.shape))
        for k in range(d):
            # The first axis is that of an angle; it is summed over, and its control values become the last axis.
            rows = values.reshape(count, BASIS, -1)
            values = np.swapaxes(rows, 1, 2) @ np.moveaxis(weights[..., k], (0, 1, 2), (2, 1, 0))
            values = values.reshape(count, -1)
        triangle = self.coefficients.shape[-1]
        return np.swapaxes(values.reshape(count, triangle, BASIS**d), 1, 2)


def _halved(boxes: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the halves (2 B, d, 2) of boxes (B, d, 2), cut at the angle with the largest `weight` (d,) · width²."""
    width = boxes[..., 1] - boxes[..., 0]
    axis = np.argmax(weight * width * width, axis=1)
    every = np.arange(len(boxes))
    middle = 0.5 * (boxes[every, axis, 0] + boxes[every, axis, 1])
    left, right = boxes.copy(), boxes.copy()
    left[every, axis, 1] = middle
    right[every, axis, 0] = middle
    return np.concatenate([left, right])


def _definite(matrices: np.ndarray, size: int, shift: float) -> np.ndarray:
    """Return (B,) whether, for every matrix A of a box, A - shift I has a Cholesky factor.

    `matrices` (B, m, s(s + 1)/2), s = `size`, are lower triangles as from `_packed`.
    """
    good, factor = np.ones(matrices.shape[:2], dtype=np.bool_), np.empty((size, size, *matrices.shape[:2]))
    for i in range(size):
        for j in range(i + 1):
            total = matrices[..., i * (i + 1) // 2 + j]
            if i == j:
                total = total - shift
            for k in range(j):
                total = total - factor[i, k] * factor[j, k]
            if i == j:
                good &= total > 0.0
                factor[i, i] = np.sqrt(np.where(total > 0.0, total, 1.0))
            else:
                factor[i, j] = total / factor[j, j]
    return np.asarray(good.all(axis=1))


def proven_in_balls(matrix: TrigMatrix, boxes: np.ndarray) -> bool:
    """Return whether a matrix of d angles is proven positive definite in every one of `boxes` (B, d, 2) [rad]."""
    coefficients = [arb(entry) for entry in _packed(matrix.exact).ravel()]
    return all(_proven(matrix, coefficients, box) for box in boxes)


def _proven(matrix: TrigMatrix, coefficients: list[arb], box: np.ndarray) -> bool:
    values = coefficients
    for low, high in box.tolist():
        middle, half = (arb(low) + arb(high)) / 2, (arb(high) - arb(low)) / 2
        weights = arb_mat(_control_weights(middle.cos(), middle.sin(), half.cos(), half.sin()))
        product = weights * arb_mat(BASIS, len(values) // BASIS, values)
        # The first axis has become control values; it becomes the last axis.
        values = [row for column in zip(*product.tolist(), strict=True) for row in column]
    triangle = matrix.size * (matrix.size + 1) // 2
    count = BASIS**matrix.angles
    controls = [[values[entry * count + index] for entry in range(triangle)] for index in range(count)]
    numbers = _unpacked(np.array([[float(entry.mid()) for entry in control] for control in controls]), matrix.size)
    try:
        factors = np.linalg.inv(np.linalg.cholesky(numbers))
    except np.linalg.LinAlgError:
        return False
    # The index of each entry of a matrix in its packed lower triangle.
    places = _unpacked(np.arange(triangle), matrix.size).tolist()
    matrices = (arb_mat([[control[at] for at in row] for row in places]) for control in controls)
    lefts = map(arb_mat, factors.tolist())
    return all(is_dominant(T * A * T.transpose()) for T, A in zip(lefts, matrices, strict=True))
