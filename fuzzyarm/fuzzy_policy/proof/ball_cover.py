"""The proof of `box_cover` again in balls, box by box, without any assumption about floating point.

The coefficients are exact, sines and cosines are balls with outward rounding (`arb` of FLINT), and each control matrix
is proven positive definite by Gershgorin's theorem on T A Tᵀ, as in `definiteness`, where T is any matrix; it comes
from a Cholesky factor in floating point.
"""

from __future__ import annotations

import numpy as np
from flint import arb, arb_mat

from fuzzyarm.fuzzy_policy.proof.kinetic_energy import BASIS
from fuzzyarm.fuzzy_policy.proof.trigonometric import TrigMatrix, control_weights, packed, unpacked

__all__ = ["proven_in_balls"]


def proven_in_balls(matrix: TrigMatrix, boxes: np.ndarray) -> bool:
    """Return whether a matrix of d angles is proven positive definite in every one of `boxes` (B, d, 2) [rad]."""
    coefficients = [arb(entry) for entry in packed(matrix.exact).ravel()]
    return all(_proven(matrix, coefficients, box) for box in boxes)


def _proven(matrix: TrigMatrix, coefficients: list[arb], box: np.ndarray) -> bool:
    values = coefficients
    for low, high in box.tolist():
        middle, half = (arb(low) + arb(high)) / 2, (arb(high) - arb(low)) / 2
        weights = arb_mat(control_weights(middle.cos(), middle.sin(), half.cos(), half.sin()))
        columns = len(values) // BASIS
        product = weights * arb_mat(BASIS, columns, values)
        # The angle in front has become control values; they go to the back.
        values = [row for column in zip(*product.tolist(), strict=True) for row in column]
    triangle = matrix.size * (matrix.size + 1) // 2
    count = BASIS**matrix.angles
    controls = [[values[entry * count + index] for entry in range(triangle)] for index in range(count)]
    numbers = unpacked(np.array([[float(entry.mid()) for entry in control] for control in controls]), matrix.size)
    diagonal = np.diagonal(numbers, axis1=1, axis2=2)
    if not (np.isfinite(numbers).all() and (diagonal > 0.0).all()):
        return False
    try:
        factors = np.linalg.inv(np.linalg.cholesky(numbers))
    except np.linalg.LinAlgError:
        return False
    return all(_dominant(control, T, matrix.size) for control, T in zip(controls, factors, strict=True))


def _dominant(control: list[arb], T: np.ndarray, size: int) -> bool:
    """Return whether T A Tᵀ is strictly diagonally dominant with a positive diagonal, for A packed in `control`."""
    A = [[control[max(i, j) * (max(i, j) + 1) // 2 + min(i, j)] for j in range(size)] for i in range(size)]
    left = arb_mat(T.tolist())
    rows = (left * arb_mat(A) * left.transpose()).tolist()
    return all(row[i] > sum((abs(row[j]) for j in range(size) if j != i), arb(0)) for i, row in enumerate(rows))
