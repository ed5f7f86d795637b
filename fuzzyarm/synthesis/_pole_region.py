"""A matrix inequality for the poles of the frozen rigid loop to lie in a region of the complex plane.

A region is the set of z with R + z S + z* Sᵀ < 0, for R symmetric and S of the same size s, such as a half plane to the
left of -α (R = 2α, S = 1), a sector |Im z| < -t Re z (R = 0, S = [[t, 1], [-1, t]]), a disc of radius r about -q (R =
[[-r, q], [q, -r]], S = [[0, 1], [0, 0]]). With the matrices of `proof._theorems`, F_ijk = A_i P + B M_jk, the Kronecker
product ⊗, slack variables Q and X of this inequality and symmetric multipliers Θ_l, every pole of every frozen loop
lies in the region if Π_iik < 0 and Π_ijk + Π_jik < 0 for i < j and all k, where

            | R⊗P + He((S⊗I) Q_ij)                     ⋆                                  ⋆    |
    Π_ijk = | I⊗F_ijk - (I⊗E_k) Q_ij + X_ijᵀ (S⊗I)ᵀ    -He((I⊗E_k) X_ij) + Σ Θ_l⊗H_lᵀH_l  ⋆    |
            | I⊗W_l P  or  -(I⊗W_l) Q_ij               0  or  -(I⊗W_l) X_ij               -Θ_l⊗I|

with a last row for each uncertainty l: the entries before "or" if l is on A, those after it if on E.

For s = 1 this is the inequality of the decay rate in `proof._theorems` without the rows d and z. Multiplication by
[I, (S⊗I)(I⊗E)⁻¹, ...] from the left and by its transpose from the right eliminates X and leaves R⊗P + He(S⊗(E⁻¹F)):
the condition of Chilali and Gahinet (1996) for E⁻¹F P⁻¹.
"""

from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.ts_model import PLANT
from fuzzyarm.proof.block_matrix import Assembly, he, identity, symmetric, transposed
from fuzzyarm.proof.vertices import Index, Vertices

__all__ = ["pi"]


def pi(
    data: Vertices,
    i: Index,
    k: Index,
    *,
    R: np.ndarray,
    S: np.ndarray,
    P: Any,
    M: Any,
    Q: Any,
    X: Any,
    theta: Any,
    put: Assembly = symmetric,
) -> Any:
    """Return Π_ijk (..., rows, rows), symmetric and affine in P, M, Q, X and Θ, for numbers or cvxpy expressions.

    The vertices are those of the consistent form, with n = 4 or, with the integral, n = 6; i and k start at 0, and
    arrays of them give a stack. R [1/s] and S are (s, s), P is (n, n), M_jk is (..., 2, n), Q_ij and X_ij are
    (..., s n, s n), and Θ (..., m, s, s) has an entry for each of `data.uncertainties`.
    """
    one, n = identity(len(S)), data.n_e
    E, wide = np.kron(one, data.error_E(k)), np.kron(S, identity(n))
    below: list[list[Any]] = []
    corner = -he(E @ X)
    for term, uncertain in enumerate(data.uncertainties):
        scale, H = theta[..., term, :, :], data.error_rows(uncertain.H.T).T
        W = np.zeros((len(uncertain.W), n))
        W[:, PLANT] = uncertain.W
        corner = corner + _kron(scale, H.T @ H)
        wide_W = np.kron(one, W)
        left, middle = (_blocks(one, W @ P), 0) if uncertain.on == "A" else (-wide_W @ Q, -wide_W @ X)
        below.append([left, middle, *[0] * len(below), -_kron(scale, identity(len(H)))])
    F = data.error_A(i) @ P + data.error_rows(data.B) @ M
    side = _blocks(one, F) - E @ Q + transposed(X) @ wide.T
    return put([[_blocks(R, P) + he(wide @ Q)], [side, corner], *below])


def _blocks(numbers: np.ndarray, matrix: Any) -> Any:
    """Return `numbers` ⊗ Y (..., s r, s c) for numbers (s, s) and Y (..., r, c)."""
    units, (r, c) = identity(len(numbers)), matrix.shape[-2:]
    return sum(
        np.kron(units[:, [a]], identity(r)) @ matrix @ (numbers[a, b] * np.kron(units[[b]], identity(c)))
        for a, b in np.argwhere(numbers)
    )


def _kron(matrix: Any, numbers: np.ndarray) -> Any:
    """Return Y ⊗ `numbers` (..., s r, s r) for Y (..., s, s) and numbers (r, r)."""
    size, r = matrix.shape[-1], len(numbers)
    left = [np.kron(identity(size), identity(r)[:, [a]]) for a in range(r)]
    return sum((numbers[a, b] * left[a]) @ matrix @ left[b].T for a, b in np.argwhere(numbers))
