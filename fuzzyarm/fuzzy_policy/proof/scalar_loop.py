"""The matrix inequality of a scheduled controller, of size three whatever the number of joints is.

In the coordinates ε = M̂^(1/2) e of the scheduled inertia the error of each joint obeys the same loop, with λ an
eigenvalue of M̂^(1/2) M̄⁻¹ M̂^(1/2), between 1/κ and 1:

    x' = (A - λ b k) x + λ b d,    x = (ε, ε', ∫ε),    A = [[0 1 0], [0 0 0], [1 0 0]],    b = (0, 1, 0)ᵀ.

V = xᵀ X x, for all joints together eᵀ(X ⊗ M̂)e, falls at least as exp(-2αt) with an L2 gain γ from d to ε if X > 0 and,
with P = X⁻¹ and m = k P, in which both inequalities are linear,

    | He(A P - λ b m) + 2 (α + μ) P   λ b   P cᵀ |
    | ⋆                               -γ²   0    | < 0,     c = (1 0 0),
    | ⋆                               ⋆     -1   |

for λ = 1/κ and λ = 1, since the matrix is affine in λ; μ bounds the rate of M̂. If at both

    | βP            ⋆  |
    | A P - λ b m   βP | > 0,

then (A - λ b k)ᵀ X (A - λ b k) < β² X, and no pole of the loop frozen at a state has a modulus above β.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.proof.block_matrix import Assembly, he, identity, symmetric
from fuzzyarm.fuzzy_policy.states import SCALAR_STATES

__all__ = ["decay", "fastest", "loop"]


def loop() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A (3, 3), b (3, 1) and c (1, 3) as whole numbers."""
    A = np.zeros((SCALAR_STATES, SCALAR_STATES), dtype=int)
    A[0, 1] = A[2, 0] = 1
    unit = identity(SCALAR_STATES)
    return A, unit[:, 1:2], unit[:1]


def decay(share: Any, *, rate: Any, gamma2: Any, P: Any, m: Any, put: Assembly = symmetric) -> Any:
    """Return the matrix of the decay and the gain, (5, 5), which has to be negative definite.

    Args:
        share: λ.
        rate: α + μ [1/s].
        gamma2: γ² [s⁴].
        P: (3, 3).
        m: k P, (1, 3).
        put: what makes a matrix of the block rows.
    """
    A, b, c = loop()
    state = he(A @ P - b @ (share * m)) + 2 * rate * P
    return put([[state], [share * b.T, -gamma2 * identity(1)], [c @ P, 0, -identity(1)]])


def fastest(share: Any, *, pole: Any, P: Any, m: Any, put: Assembly = symmetric) -> Any:
    """Return the matrix of the fastest pole β [1/s], (6, 6), which has to be positive definite; see `decay`."""
    A, b, _ = loop()
    return put([[pole * P], [A @ P - b @ (share * m), pole * P]])
