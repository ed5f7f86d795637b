"""The matrix inequality of a scheduled controller, of size three whatever the number of joints is.

In the coordinates ε = M̂^(1/2) e of the scheduled inertia the error of each joint obeys the same loop, with λ an
eigenvalue of M̂^(1/2) M̄⁻¹ M̂^(1/2), between 1/κ and 1:

    x' = (A - λ b k) x + λ b d,    x = (ε, ε', ∫ε),    A = [[0 1 0], [0 0 0], [1 0 0]],    b = (0, 1, 0)ᵀ.

V = xᵀ X x, for all joints together eᵀ(X ⊗ M̂)e, falls at least as exp(-2αt) with an L2 gain γ from d to ε if X > 0 and

    | He(X (A - λ b k)) + 2 (α + μ) X + cᵀc   λ X b |
    | ⋆                                        -γ²   | < 0,     c = (1 0 0),

for λ = 1/κ and λ = 1, since the matrix is affine in λ; μ bounds the rate of M̂. If at both

    | βX                ⋆  |
    | X (A - λ b k)     βX | > 0,

then (A - λ b k)ᵀ X (A - λ b k) < β² X, and no pole of the loop frozen at a state has a modulus above β.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.proof.block_matrix import he, symmetric
from fuzzyarm.fuzzy_policy.states import SCALAR_STATES

__all__ = ["decay", "fastest", "loop"]


def loop() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A (3, 3), b (3, 1) and c (1, 3) as whole numbers."""
    A = np.zeros((SCALAR_STATES, SCALAR_STATES), dtype=int)
    A[0, 1] = A[2, 0] = 1
    unit = np.eye(SCALAR_STATES, dtype=int)
    return A, unit[:, 1:2], unit[:1]


def decay(share: Any, *, rate: Any, gamma2: Any, X: Any, k: Any) -> Any:
    """Return the matrix of the decay and the gain, (4, 4), which has to be negative definite.

    Args:
        share: λ.
        rate: α + μ [1/s].
        gamma2: γ² [s⁴].
        X: (3, 3).
        k: (1, 3) [1/s², 1/s, 1/s³].
    """
    A, b, c = loop()
    state = he(X @ (A - share * b @ k)) + 2 * rate * X + c.T @ c
    return symmetric([[state], [share * (X @ b).T, -gamma2 * np.eye(1, dtype=int)]])


def fastest(share: Any, *, pole: Any, X: Any, k: Any) -> Any:
    """Return the matrix of the fastest pole β [1/s], (6, 6), which has to be positive definite; see `decay`."""
    A, b, _ = loop()
    return symmetric([[pole * X], [X @ (A - share * b @ k), pole * X]])
